"""Run folders on disk: scores, label maps, poses and learning curves."""
