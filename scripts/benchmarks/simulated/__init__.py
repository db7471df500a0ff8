"""Surveys whose truth is known: simulated scenes, small builds of boxes, and edited second epochs of real tiles.

The benchmarks measure on them, and so do the tests.
"""
