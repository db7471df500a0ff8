"""Touching houses: where one house may end and the next begin, and the reasons that keep them apart."""
