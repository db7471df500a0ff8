"""The readers and writers of files: the only place that opens one."""
