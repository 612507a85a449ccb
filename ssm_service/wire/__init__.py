"""Messages, keys, and the strict passage between bytes and values."""

from .convert import (
    VALUES,
    command_message,
    evaluate_message,
    frames_message,
    obstacles_from,
    optional_readings,
    question_from,
    separation_message,
    separation_pairs,
    zone_message,
)
from .decode import Decoder, all_finite
from .gate import ProducerGate, old_seq
from .integrity import Heard, opened, seal
from .keys import Keys, robot_of
from .messages import encoding_of, json_schemas, names_another
from .samples import attachment_of, check_sample
from .sealed import Opened, SealedDecoder

__all__ = [
    "VALUES",
    "Decoder",
    "Heard",
    "Keys",
    "Opened",
    "ProducerGate",
    "SealedDecoder",
    "all_finite",
    "attachment_of",
    "check_sample",
    "command_message",
    "encoding_of",
    "evaluate_message",
    "frames_message",
    "json_schemas",
    "names_another",
    "obstacles_from",
    "old_seq",
    "opened",
    "optional_readings",
    "question_from",
    "robot_of",
    "seal",
    "separation_message",
    "separation_pairs",
    "zone_message",
]
