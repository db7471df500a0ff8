"""The flat-region detector: differential morphological and attribute profiles (Mongus et al. 2013, section 3)."""
