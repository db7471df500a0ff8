"""Labelled places, copies of them as other sensors and lands would give them, and what a build is worth on each."""
