"""Joints, readings, obstacles and a target in; one zone, one set of limits and one command out."""

from .decision import Comparison, Decision, Nearest, SourceReport
from .estimates import Estimators
from .evaluate import EvaluatedPair, Evaluation, EvaluationInput, Evaluator
from .inputs import (
    TARGET_KINDS,
    Inputs,
    JointSample,
    Received,
    Target,
    checked_target,
    joint_sample,
    range_scan,
)
from .monitor import SOURCES, Monitor, default_valid_for, zone_profile
from .ranges import PreparedScan, RangeReader
from .reaction import configured_reaction, standstill_distance, stopping_levels
from .separated import Separated
from .weakness import Weakness, weaknesses

__all__ = [
    "SOURCES",
    "TARGET_KINDS",
    "Comparison",
    "Decision",
    "Estimators",
    "EvaluatedPair",
    "Evaluation",
    "EvaluationInput",
    "Evaluator",
    "Inputs",
    "JointSample",
    "Monitor",
    "Nearest",
    "PreparedScan",
    "RangeReader",
    "Received",
    "Separated",
    "SourceReport",
    "Target",
    "Weakness",
    "checked_target",
    "configured_reaction",
    "default_valid_for",
    "joint_sample",
    "range_scan",
    "standstill_distance",
    "stopping_levels",
    "weaknesses",
    "zone_profile",
]
