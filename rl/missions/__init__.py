"""The missions there are, a package each; the contract is rl/mission.py."""
