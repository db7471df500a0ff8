"""The command line: a thin shell around `msbdb.api`, and the only home of click and rich."""
