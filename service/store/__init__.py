"""Where the service keeps what it acknowledged: one database, SQLite or PostgreSQL."""
