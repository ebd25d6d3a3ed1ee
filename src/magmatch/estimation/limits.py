# SPDX-License-Identifier: BSD-3-Clause
"""Limits of effort: how much is tried, drawn, compared and kept. They bound time and memory.

More of each takes longer, and is meant to change no answer by more than its uncertainty; what shapes an answer stands
where it is used.
"""

# Points or samples that stand for a survey: at most, for ranking a few poses, and for judging thousands. Where there
# are too many, the distance between them grows by a factor until there are not.
MOST_POINTS, RANKING_POINTS, FEW_POINTS, COARSER = 4000, 600, 60, 1.2
# Bins, or cells of a map, that are weighed together: the cost is cubic in it.
MAX_WEIGHED = 150
# Posterior samples that give the spread of what is derived from a map; most poses drawn from a prior, and factor on
# the neighbours tried if a prior rules most of them out.
N_DRAWS, MOST_DRAWN, MORE_NEIGHBOURS = 8, 6000, 4
# Each later look costs more, and is given to one in so many.
RARER = 2
# Of what a search ranks, poses or maps, those that are handed on, those that are looked at first, and those tried
# with a change of the field; the rest are not looked at where one of the first has so many nats.
N_CANDIDATES, CLEAR = 8, 50.0
N_REFINED = N_CANDIDATES // RARER
N_CHANGED = N_REFINED // RARER
# Steps of a pose; of a walk, first with like components, then with those coupled.
MOST_STEPS = 10
COARSE_STEPS = MOST_STEPS // RARER
FINE_STEPS = COARSE_STEPS // RARER
# Search by invariants: anchors, base points that each is tried on, distinct poses refined coarsely and further.
N_ANCHORS, N_NEIGHBOURS, N_COARSE, N_FINE = 400, 30, 600, 40
# Search by pairs: pairs in a table, base pairs that each is tried on.
MAX_PAIRS, N_LIKE_PAIRS = 600_000, 8
# Votes of many maps: maps asked (a folder ten times larger costs little more).
MAX_ASKED = 300
# Changes of the field: samples compared and charges (with half as many of both, the target's own field is described
# so badly that wrong poses win), updates of the charges' strengths per step.
CHANGE_SAMPLES, N_CHARGES, N_STRENGTHS = 1000, 400, 4
# Points of a raster, and known ones up to which a ragged one is refined; points in a tree's leaf: few enough to scan;
# maps of a folder in memory.
MAX_RASTER, MAX_REFINED, LEAF, MAX_LOADED = 1_500_000, 20_000, 24, 20
