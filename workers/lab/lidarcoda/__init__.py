"""LidarCODA: point labels from the 2D boxes of CODA, and the paper's measures on them.

Source: arXiv 2407.14306, sections III-D and IV. The steps are in this order: `annotations`,
`cameras`, `clustering` (`build` runs them), `grades`, `labels`, then `matching`, `measures` and
`evaluation`. Every file is found by the id of its image or annotation, never by its position in a
sorted folder.
"""
