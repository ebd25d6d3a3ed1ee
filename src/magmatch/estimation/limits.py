# SPDX-License-Identifier: BSD-3-Clause
"""Limits of effort: how much is tried, drawn, compared and kept. They bound time and memory.

More of each takes longer, and is meant to change no answer by more than its uncertainty; what shapes an answer stands
where it is used.
"""

# Points or samples that stand for a survey: at most, for ranking a few poses, and for judging thousands. Where there
# are too many, the distance between them grows by a factor until there are not.
MOST_POINTS, RANKING_POINTS, FEW_POINTS, COARSER = 4000, 600, 60, 1.2
# Each later look costs more, and is given to one in so many.
RARER = 2
# Bins, or cells of a map, that are weighed together: the cost is cubic in it.
MAX_WEIGHED = 150
# Few of what costs much or hardly differs: posterior samples that give the spread of what is derived from a map; base
# pairs that a pair of a walk is tried on; of what a search ranks, poses or maps, those that are handed on.
N_DRAWS = N_LIKE_PAIRS = N_CANDIDATES = 8
# Of those, the ones that are looked at first, and those tried with a change of the field; the rest are not looked at
# where one of the first has so many nats.
N_REFINED = N_CANDIDATES // RARER
N_CHANGED = N_REFINED // RARER
CLEAR = 50.0
# Steps of a pose; of a walk, first with like components, then with those coupled.
MOST_STEPS = 10
COARSE_STEPS = MOST_STEPS // RARER
FINE_STEPS = COARSE_STEPS // RARER
# Places chosen on a map: anchors of a search by invariants, charges of a change of the field.
N_ANCHORS = N_CHARGES = 400
# Base points that each anchor is tried on, and factor on these, as on base pairs, if a prior rules most of them out;
# distinct poses refined coarsely, as many as points that rank one, and further.
N_NEIGHBOURS = FEW_POINTS // RARER
MORE_NEIGHBOURS = RARER * RARER
N_COARSE, N_FINE = RANKING_POINTS, 40
# Pairs in a table; most poses drawn from a prior.
MAX_PAIRS, MOST_DRAWN = 600_000, 6000
# Votes of many maps: maps asked (a folder ten times larger costs little more); maps of a folder in memory.
MAX_ASKED, MAX_LOADED = RANKING_POINTS // RARER, 20
# Changes of the field: samples compared (with half as many, and half of the charges, the target's own field is
# described so badly that wrong poses win), updates of the charges' strengths per step.
CHANGE_SAMPLES, N_STRENGTHS = 1000, 4
# Points of a raster, and known ones up to which a ragged one is refined; points in a tree's leaf: few enough to scan.
MAX_RASTER, MAX_REFINED, LEAF = 1_500_000, 20_000, 24
