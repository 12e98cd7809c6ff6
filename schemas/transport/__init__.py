"""Transport of records: buckets, the bus and their encodings."""
