"""The tree of parts inside buildings: clusters, duplicates, links, reshaping, fake fathers (Vu et al. 2009)."""
