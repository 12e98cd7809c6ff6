"""What keeps N workers alive; the ledger alone knows what is done."""
