"""Data model shared by all packages. Imports numpy and pydantic only."""
