"""Logs for tests and faults: a short one, all that can be read from one, and forged ones."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mcap.records import Attachment, Channel, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

import aslip
from aslip.envs import default_stack
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.library import GaitLibrary
from aslip.log import Recorder, Recording, Series, check, read, recover, replay
from aslip.log.frozen_model import MODEL_FILE, SETTINGS_FILE
from aslip.log.writer import HASH_KEY, METADATA, add_metadata, open_writer

_STEPS = 36
_TRUE: dict[str, Series] = {}
"""Messages of the whole log, which is loaded first."""


def write_log(path: Path) -> None:
    """Log one fall; replaces a file that is there.

    Raises:
        OSError: the file cannot be written, of which the recorder would only warn; what could be
            recovered of it is deleted.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            _fall(path)
    except (ConfigurationError, RuntimeWarning) as error:
        path.with_name(path.name + ".part").unlink(missing_ok=True)
        raise OSError(str(error)) from error


def _fall(path: Path) -> None:
    library = GaitLibrary.load()
    recorder = partial(Recorder, path, library=library, overwrite=True)
    env = aslip.make_env(stack={**default_stack(library), "recorder": recorder}, num_threads=1)
    td = env.reset()
    for _ in range(_STEPS):
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(1, 10)))
    env.close()


def load_log(path: Path) -> Any:
    """Everything that `read` and `replay` return but the date of writing.

    Raises:
        FileDamagedError: the log is damaged.
        ValueError: `recover` saved other messages than were written.
    """
    recovered = path.with_name("recovered.mcap")
    saved = None
    with suppress(FileDamagedError):
        saved = read(recover(path, recovered).path)
    recovered.unlink(missing_ok=True)
    try:
        log = read(path)
    except FileDamagedError:
        _require_some(saved, _TRUE)
        raise
    _TRUE.update(log.series if not _TRUE else {})
    _require_some(saved, log.series)
    series = {topic: {"time": s.time, **s.columns} for topic, s in log.series.items()}
    arrays = {t: {k: v.tolist() for k, v in columns.items()} for t, columns in series.items()}
    check(path)
    metadata = {key: text for key, text in log.metadata.items() if key != "started_utc"}
    content = {"metadata": metadata, "end": log.end, "files": log.attachments}
    return {**content, "series": arrays, "replay": _replayed(log)}


def _require_some(saved: Recording | None, written: Mapping[str, Series]) -> None:
    """Raise ValueError if a recovered log has a message that was not written."""
    for topic, series in saved.series.items() if saved and written else ():
        true = written[topic]
        for name, column in {"time": series.time, **series.columns}.items():
            whole = true.time if name == "time" else true[name]
            if not set(map(repr, column.tolist())) <= set(map(repr, whole.tolist())):
                raise ValueError(f"{topic} {name} was recovered otherwise than it was written")


def _replayed(log: Recording) -> dict[str, Any]:
    """Columns that a replay computes."""
    result = replay(log, strict=False)
    arrays = (result.state_time, result.drift, result.qpos, result.qvel)
    return {"steps": result.steps, "doubts": result.doubts, "path": [a.tolist() for a in arrays]}


# ----------------------------------------------------------- taken apart, put together


def taken_apart(data: bytes) -> list[McapRecord]:
    """Metadata, attachments, schemas, channels and messages of a whole log."""
    kinds, records = (Metadata, Attachment, Schema, Channel, Message), []
    for record in StreamReader(BytesIO(data)).records:
        if isinstance(record, DataEnd):  # what follows is a summary of the rest
            break
        if isinstance(record, kinds):
            records.append(record)
    return records


def put_together(records: Sequence[McapRecord]) -> bytes:
    """A log of records, whose checksums are right; hashes of attachments are not touched."""
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


def with_hashes(records: Sequence[McapRecord]) -> list[McapRecord]:
    """Records whose metadata have the hashes of the attachments among them."""
    files = [record for record in records if isinstance(record, Attachment)]
    hashes = {HASH_KEY + file.name: hashlib.sha256(file.data).hexdigest() for file in files}

    def signed(record: McapRecord) -> McapRecord:
        if not isinstance(record, Metadata) or record.name != METADATA:
            return record
        return replace(record, metadata={**record.metadata, **hashes})

    return [signed(record) for record in records]


# ----------------------------------------------------------------- forged ones

Damage = Callable[[bytes, np.random.Generator], bytes]
_NUMBERS = (0.0, -1.0, 0.5, 1.0, 7.0, 9.0, 1e3, 1e9, -1e300, 2.0**31, np.nan, np.inf)
_WORDS = ("0", "-1", "0.5", "7", "33", "true", '"yes"', "1e9", "1e-9", "NaN", "[1]", "9" * 50)
# bytes before the numbers of a message, which say how it is encoded
_ENCAPSULATION = 4
# numbers of a state before the first motor's commands: episode, step, a length; time, positions and
# velocities. From one motor to the next: one for users, the newest command's place, times, commands
_BEFORE_COMMANDS, _PER_MOTOR, _MOTORS = 3 + 1 + 35 + 32, 2 + 2 * 8, 10


def _forged(change: Callable[[list[McapRecord], np.random.Generator], None]) -> Damage:
    """Damage to the records of a log, whose checksums and hashes are then right."""

    def damage(data: bytes, rng: np.random.Generator) -> bytes:
        records = taken_apart(data)
        change(records, rng)
        return put_together(with_hashes(records))

    return damage


def _numbers_of(topic: str, places: Sequence[int] | None = None) -> Damage:
    """Put another number in a place of one message of a topic, or of all."""

    def change(records: list[McapRecord], rng: np.random.Generator) -> None:
        channel = next(r.id for r in records if isinstance(r, Channel) and r.topic == topic)
        found = [i for i, r in enumerate(records) if isinstance(r, Message)]
        found = [i for i in found if _message(records[i]).channel_id == channel]
        count = (len(_message(records[found[0]]).data) - _ENCAPSULATION) // 8
        place, value = int(rng.choice(places or count)), float(rng.choice(_NUMBERS))
        for i in found if rng.integers(2) else [int(rng.choice(found))]:
            data = bytearray(_message(records[i]).data)
            start = _ENCAPSULATION + 8 * place
            data[start : start + 8] = np.float64(value).tobytes()
            records[i] = replace(_message(records[i]), data=bytes(data))

    return _forged(change)


def _message(record: McapRecord) -> Message:
    assert isinstance(record, Message)
    return record


def _one(kind: type[McapRecord], change: Callable[[Any, np.random.Generator], Any]) -> Damage:
    """Change one record of a kind."""

    def damage(records: list[McapRecord], rng: np.random.Generator) -> None:
        i = int(rng.choice([i for i, record in enumerate(records) if isinstance(record, kind)]))
        records[i] = change(records[i], rng)

    return _forged(damage)


def _other_byte(data: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(data)))
    return data[:place] + rng.bytes(1) + data[place + 1 :]


def _other_time(message: Message, rng: np.random.Generator) -> Message:
    times = [0, 1, message.log_time + 10**6, 10**9, 2**62, 2**64 - 1]
    time = times[int(rng.integers(len(times)))]
    return replace(message, log_time=time, publish_time=time)


def _other_file(name: str, change: Callable[[str, np.random.Generator], str]) -> Damage:
    """Change the text of an attachment."""

    def damage(records: list[McapRecord], rng: np.random.Generator) -> None:
        for i, record in enumerate(records):
            if isinstance(record, Attachment) and record.name == name:
                text = change(bytes(record.data).decode(), rng)
                records[i] = replace(record, data=text.encode())

    return _forged(damage)


def _other_setting(text: str, rng: np.random.Generator) -> str:
    settings = json.loads(text)
    name = str(rng.choice([*settings, "gravity"]))
    words = {key: json.dumps(value) for key, value in settings.items()}
    words[name] = str(rng.choice(_WORDS))
    return "{" + ", ".join(f'"{key}": {word}' for key, word in words.items()) + "}"


def _other_number(text: str, rng: np.random.Generator) -> str:
    """Put another number in the place of one of an attribute."""
    found = list(re.finditer(r'(?<=[" ])-?[\d.]+(?=[" ])', text))
    one = found[int(rng.integers(len(found)))]
    factor = float(rng.choice([0, -1, 1e-9, 0.5, 2, 5, 9, 1e3, 1e30]))
    other = f"{float(one[0]) * factor:g}" if rng.integers(2) else f"{factor:g}"
    return text[: one.start()] + other + text[one.end() :]


FORGED_LOGS: dict[str, Damage] = {
    "forged state": _numbers_of("/state"),
    "forged place of commands": _numbers_of(
        "/state", [_BEFORE_COMMANDS + 1 + motor * _PER_MOTOR for motor in range(_MOTORS)]
    ),
    "forged dynamics": _numbers_of("/dynamics"),
    "forged step": _numbers_of("/step"),
    "forged message": _one(Message, lambda m, rng: replace(m, data=_other_byte(m.data, rng))),
    "forged time": _one(Message, _other_time),
    "forged definition": _one(Schema, lambda s, rng: replace(s, data=_other_byte(s.data, rng))),
    "forged settings": _other_file(SETTINGS_FILE, _other_setting),
    "forged model": _other_file(MODEL_FILE, _other_number),
}
"""Damage to a log's content that is itself in order: what a stranger may have written."""
