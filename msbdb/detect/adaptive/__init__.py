"""The detector by vegetation removal and stepwise clustering of off-ground points (slides, Bathurst)."""
