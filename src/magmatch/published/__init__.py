# SPDX-License-Identifier: BSD-3-Clause
"""The published method, Mag-Match [McDonald2025], part by part.

``infer`` the field at X*; ``detect`` keypoints; lay ``local_frames``; ``describe`` what lies around; ``match``
descriptors; find a ``consensus``; check its ``fitness``. ``register`` does all seven, with a detector, descriptor or
matcher of your own if you give one: ``examples/06_own_descriptor.py``. What differs from the paper is in
``docs/theory/published.md``.
"""

from magmatch.features.descriptors import describe
from magmatch.features.extract import Features
from magmatch.features.infer import Inferred, infer
from magmatch.features.keypoints import detect
from magmatch.features.local_frames import LocalFrames, local_frames
from magmatch.published.config import PublishedConfig
from magmatch.published.consensus import Consensus, consensus
from magmatch.published.fitness import Fitness, fitness
from magmatch.published.matching import Matches, match
from magmatch.published.recursion import RecursiveField, recursively
from magmatch.published.register import FIELD, Descriptor, Detector, Matcher, Published, register

__all__ = [
    "FIELD",
    "Consensus",
    "Descriptor",
    "Detector",
    "Features",
    "Fitness",
    "Inferred",
    "LocalFrames",
    "Matcher",
    "Matches",
    "Published",
    "PublishedConfig",
    "RecursiveField",
    "consensus",
    "describe",
    "detect",
    "fitness",
    "infer",
    "local_frames",
    "match",
    "recursively",
    "register",
]
