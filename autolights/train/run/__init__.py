"""A training run: preparation, the loop, several processes, stopping and going on, what it leaves behind."""
