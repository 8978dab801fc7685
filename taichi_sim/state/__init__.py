"""What an environment remembers: snapshots, copies and forks; the last step of one that diverged."""
