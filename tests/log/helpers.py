"""Walks to record, records of logs, and comparisons of logs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import torch
from mcap.records import Attachment, Channel, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from tensordict import TensorDict

from aslip.envs import StackEnv
from aslip.log import Recording
from aslip.log.writer import add_metadata, open_writer
from aslip.transforms.rewards import PAPER_WEIGHTS

MakeRecorded = Callable[..., StackEnv]
Alter = Callable[[Callable[[bytearray], None]], Path]

# topic and field of the curves in every layout
VELOCITIES = {
    ("/step", "command"),
    ("/reference", "body_velocity_x"),
    ("/truth", "pelvis_velocity_x"),
    ("/estimate", "velocity_x"),
}
CURVES = {
    *VELOCITIES,
    *(("/step", f"term_{name}") for name in PAPER_WEIGHTS),
    *(("/step", f"ground_force_{side}_z") for side in ("left", "right")),
}


def run(env: StackEnv, steps: int, size: float = 0.1) -> list[TensorDict]:
    """Take steps with random actions and resets; return the tensordict of each step."""
    generator = torch.Generator().manual_seed(0)
    seen, td = [], env.reset()
    for step in range(steps):
        action = size * torch.randn(env.num_envs, 10, generator=generator)
        td["action"] = action
        if step in (3, 4):
            td["push"] = torch.tensor([[0.0, 20.0, 0.0]]).expand(env.num_envs, 3).clone()
        stepped, td = env.step_and_maybe_reset(td)
        seen.append(stepped.clone())
        td = td.exclude("push")
    return seen


def with_column(recording: Recording, topic: str, name: str, column: np.ndarray) -> Recording:
    """Recording with another column in a topic."""
    series = recording[topic]
    other = replace(series, columns={**series.columns, name: column})
    return replace(recording, series={**recording.series, topic: other})


def read_records(data: bytes) -> list[McapRecord]:
    """Metadata, attachments, schemas, channels and messages of an intact log."""
    kinds, records = (Metadata, Attachment, Schema, Channel, Message), []
    for record in StreamReader(BytesIO(data)).records:
        if isinstance(record, DataEnd):  # followed by the summary only
            break
        if isinstance(record, kinds):
            records.append(record)
    return records


def write_records(records: Sequence[McapRecord]) -> bytes:
    """Write a log of records with matching checksums, and unchanged hashes of attachments."""
    file = BytesIO()
    writer, schemas, channels = open_writer(file), {0: 0}, {}
    for record in records:
        if isinstance(record, Metadata):
            add_metadata(writer, record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(0, 0, record.name, record.media_type, record.data)
        elif isinstance(record, Schema):
            new = writer.register_schema(record.name, record.encoding, record.data)
            schemas[record.id] = new
        elif isinstance(record, Channel):
            encoding, schema = record.message_encoding, schemas[record.schema_id]
            channels[record.id] = writer.register_channel(record.topic, encoding, schema)
        elif isinstance(record, Message):
            channel, time = channels[record.channel_id], record.log_time
            writer.add_message(channel, time, record.data, record.publish_time, record.sequence)
    writer.finish()
    return file.getvalue()
