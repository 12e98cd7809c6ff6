"""The third witness: what free space says, of the seconds before and after."""
