"""One survey against the inventory: offset, matching, decisions; and the net change between two dates."""
