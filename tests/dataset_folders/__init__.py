"""Writers of folders in the layouts of published data sets, for tests of the converters."""
