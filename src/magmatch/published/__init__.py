# SPDX-License-Identifier: BSD-3-Clause
"""The published method, Mag-Match [McDonald2025], part by part.

Make two maps ``comparable``; ``infer`` the field at X*; ``detect`` keypoints; lay ``local_frames``; ``describe`` what
lies around; ``match`` descriptors; find a ``consensus``; check its ``fitness``. ``register`` does all of it, with a
detector, descriptor or matcher of your own if you give one: ``examples/06_own_descriptor.py``. What differs from the
paper is in ``docs/theory/published.md``.
"""

from magmatch.features.config import FeatureConfig
from magmatch.features.descriptors import describe
from magmatch.features.extract import Features, features_of
from magmatch.features.infer import Inferred, infer
from magmatch.features.keypoints import detect
from magmatch.features.local_frames import LocalFrames, local_frames
from magmatch.published.config import PublishedConfig
from magmatch.published.consensus import Consensus, ConsensusConfig, consensus
from magmatch.published.fitness import Fitness, FitnessConfig, fitness
from magmatch.published.matching import Matches, MatchingConfig, match
from magmatch.published.recursion import RecursiveField, recursively
from magmatch.published.register import FIELD, Descriptor, Detector, Matcher, Published, comparable, register

__all__ = [
    "FIELD",
    "Consensus",
    "ConsensusConfig",
    "Descriptor",
    "Detector",
    "FeatureConfig",
    "Features",
    "Fitness",
    "FitnessConfig",
    "Inferred",
    "LocalFrames",
    "Matcher",
    "Matches",
    "MatchingConfig",
    "Published",
    "PublishedConfig",
    "RecursiveField",
    "comparable",
    "consensus",
    "describe",
    "detect",
    "features_of",
    "fitness",
    "infer",
    "local_frames",
    "match",
    "recursively",
    "register",
]
