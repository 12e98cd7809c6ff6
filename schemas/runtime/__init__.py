"""Helpers that every process of ours needs to run: logging, retries, HTTP."""
