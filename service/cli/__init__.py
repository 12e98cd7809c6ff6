"""Command line `counterpoint`, with a file per group of verbs."""
