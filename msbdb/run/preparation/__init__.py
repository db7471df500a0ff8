"""From the files of a survey to its scene: drafts, the plan that fixes their values, and the surfaces of rasters."""
