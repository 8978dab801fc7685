"""Run folders, the main job, processes, live views, tuning."""
