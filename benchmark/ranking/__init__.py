"""Statistics, ranks and the leaderboard."""
