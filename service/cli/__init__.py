"""The one command, `counterpoint`, a file per group of verbs."""
