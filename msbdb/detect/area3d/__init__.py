"""The detector by multi-scale 3-D area morphology on the points (Cao & Wu)."""
