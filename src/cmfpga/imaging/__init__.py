"""Images of warped events, their contrast, and pictures of both, in NumPy float64.

All tools take them from here. Two rooms have their own on purpose: :mod:`cmfpga.reference.floating`, which everything
is judged against, and the programs of :mod:`studies.bench.opponents`, which are written for speed and compared with it.
"""
