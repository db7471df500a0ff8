"""The composition of the stages: one survey from its files to what the database keeps."""
