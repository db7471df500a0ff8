"""Pictures of the results: the only home of matplotlib."""
