"""What users call: build, update, relabel, classify, evaluate, view, export, changes, imports, open."""
