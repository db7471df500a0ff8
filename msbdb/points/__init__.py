"""Points: the cloud, neighbours, the graph of connected points, density, and 3-D area morphology on points."""
