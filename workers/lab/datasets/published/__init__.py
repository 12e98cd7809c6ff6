"""Readers of published data sets in their own folder layouts, one module each."""
