"""The command line: a thin shell around the pipeline, and the only home of click and rich."""
