"""Runs: checked, written in one transaction, and read back."""
