"""The worker: claim, read, mine, publish, commit."""
