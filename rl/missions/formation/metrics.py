"""What the figures of an evaluation mean."""

DEFINITIONS = {
    "leader_error_rms_m": "root mean square distance of the leader from its target, over time and episodes",
    "leader_error_p95_m": "95th percentile of the same distance",
    "follower_error_rms_m": "root mean square distance of followers from their slots (null without followers)",
    "follower_error_p95_m": "95th percentile of the same distance",
    "collisions_per_hour": "vehicles that hit an obstacle or a team mate, per hour of the team's operation",
    "collision_free_episodes": "fraction of episodes in which no vehicle of the team collided",
    "success_rate": "fraction of episodes that ran their full time with no vehicle of the team lost, crashed, "
    "collided or out of the area, and in which the rms error of every vehicle stayed below "
    "evaluation.success_error",
}
