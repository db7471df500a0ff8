"""A survey larger than memory: cut in tiles on the absolute lattice, built one by one, merged in the database."""
