"""Runs: check them, write them in one transaction, and read them."""
