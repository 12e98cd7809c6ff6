"""Locks of the system: who may listen, certificates, rules of access, bill of materials."""
