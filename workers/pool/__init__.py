"""Worker pool: keeps N worker processes alive; completed work is recorded in the ledger alone."""
