"""Durable state of the service: one database, SQLite or PostgreSQL."""
