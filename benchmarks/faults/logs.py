"""Logs for tests and fault injection: writing, reading, forging."""

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
_WRITTEN: dict[str, Series] = {}
"""Messages of the intact log, stored when it is loaded before the damaged ones."""


def write_log(path: Path) -> None:
    """Log one fall, replacing an existing file.

    Raises:
        OSError: the file cannot be written, and the partial file is deleted. (The recorder itself
            only warns.)
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            _log_fall(path)
    except (ConfigurationError, RuntimeWarning) as error:
        path.with_name(path.name + ".part").unlink(missing_ok=True)
        raise OSError(str(error)) from error


def _log_fall(path: Path) -> None:
    library = GaitLibrary.load()
    recorder = partial(Recorder, path, library=library, overwrite=True)
    stack = {**default_stack(library), "recorder": recorder}
    env = aslip.make_env(stack=stack, num_threads=1, seed=0)
    td = env.reset()
    for _ in range(_STEPS):
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(1, 10)))
    env.close()


def load_log(path: Path) -> Any:
    """Return values of `read` and `replay`, except for the date of writing.

    Raises:
        FileDamagedError: the log is damaged.
        ValueError: `recover` saved a message that was never written.
    """
    recovered = path.with_name("recovered.mcap")
    saved = None
    with suppress(FileDamagedError):
        saved = read(recover(path, recovered).path)
    recovered.unlink(missing_ok=True)
    try:
        log = read(path)
    except FileDamagedError:
        _require_some(saved, _WRITTEN)
        raise
    _WRITTEN.update(log.series if not _WRITTEN else {})
    _require_some(saved, log.series)
    series = {topic: {"time": s.time, **s.columns} for topic, s in log.series.items()}
    arrays = {t: {k: v.tolist() for k, v in columns.items()} for t, columns in series.items()}
    check(path)
    metadata = {key: text for key, text in log.metadata.items() if key != "started_utc"}
    content = {"metadata": metadata, "end": log.end, "files": log.attachments}
    return {**content, "series": arrays, "replay": _replay_results(log)}


def _require_some(saved: Recording | None, written: Mapping[str, Series]) -> None:
    """Raise a ValueError if a recovered log has a message that was never written."""
    for topic, series in saved.series.items() if saved and written else ():
        true = written[topic]
        for name, column in {"time": series.time, **series.columns}.items():
            whole = true.time if name == "time" else true[name]
            if not set(map(repr, column.tolist())) <= set(map(repr, whole.tolist())):
                raise ValueError(
                    f"{topic} {name} was recovered with values that were never written"
                )


def _replay_results(log: Recording) -> dict[str, Any]:
    """Results of a replay, as lists."""
    result = replay(log, strict=False)
    arrays = (result.state_time, result.drift, result.qpos, result.qvel)
    return {"steps": result.steps, "doubts": result.doubts, "path": [a.tolist() for a in arrays]}


# ----------------------------------------------------------- records


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


def update_hashes(records: Sequence[McapRecord]) -> list[McapRecord]:
    """Records with the attachments' hashes updated in the metadata."""
    files = [record for record in records if isinstance(record, Attachment)]
    hashes = {HASH_KEY + file.name: hashlib.sha256(file.data).hexdigest() for file in files}

    def with_hashes(record: McapRecord) -> McapRecord:
        if not isinstance(record, Metadata) or record.name != METADATA:
            return record
        return replace(record, metadata={**record.metadata, **hashes})

    return [with_hashes(record) for record in records]


# ----------------------------------------------------------------- forging

Damage = Callable[[bytes, np.random.Generator], bytes]
_NUMBERS = (0.0, -1.0, 0.5, 1.0, 7.0, 9.0, 1e3, 1e9, -1e300, 2.0**31, np.nan, np.inf)
_WORDS = ("0", "-1", "0.5", "7", "33", "true", '"yes"', "1e9", "1e-9", "NaN", "[1]", "9" * 50)
# bytes of a message's header, which names the encoding
_ENCAPSULATION = 4
# sizes in a state: before the first motor's buffer (episode, step, length, time; qpos; qvel), and
# of a motor's buffer (user value, index of the newest command; times, commands)
_BEFORE_COMMANDS, _PER_MOTOR, _MOTORS = 3 + 1 + 35 + 32, 2 + 2 * 8, 10


def _forge(change: Callable[[list[McapRecord], np.random.Generator], None]) -> Damage:
    """Damage that changes the records of a log and makes checksums and hashes match."""

    def damage(data: bytes, rng: np.random.Generator) -> bytes:
        records = read_records(data)
        change(records, rng)
        return write_records(update_hashes(records))

    return damage


def _forge_number(topic: str, places: Sequence[int] | None = None) -> Damage:
    """Damage that replaces a number in one message of a topic, or in all messages."""

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

    return _forge(change)


def _message(record: McapRecord) -> Message:
    assert isinstance(record, Message)
    return record


def _forge_record(
    kind: type[McapRecord], change: Callable[[Any, np.random.Generator], Any]
) -> Damage:
    """Damage that changes one record of a class."""

    def damage(records: list[McapRecord], rng: np.random.Generator) -> None:
        i = int(rng.choice([i for i, record in enumerate(records) if isinstance(record, kind)]))
        records[i] = change(records[i], rng)

    return _forge(damage)


def _replace_byte(data: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(data)))
    return data[:place] + rng.bytes(1) + data[place + 1 :]


def _replace_time(message: Message, rng: np.random.Generator) -> Message:
    times = [0, 1, message.log_time + 10**6, 10**9, 2**62, 2**64 - 1]
    time = times[int(rng.integers(len(times)))]
    return replace(message, log_time=time, publish_time=time)


def _forge_attachment(name: str, change: Callable[[str, np.random.Generator], str]) -> Damage:
    """Damage that changes the text of an attachment."""

    def damage(records: list[McapRecord], rng: np.random.Generator) -> None:
        for i, record in enumerate(records):
            if isinstance(record, Attachment) and record.name == name:
                text = change(bytes(record.data).decode(), rng)
                records[i] = replace(record, data=text.encode())

    return _forge(damage)


def _replace_setting(text: str, rng: np.random.Generator) -> str:
    settings = json.loads(text)
    name = str(rng.choice([*settings, "gravity"]))
    words = {key: json.dumps(value) for key, value in settings.items()}
    words[name] = str(rng.choice(_WORDS))
    return "{" + ", ".join(f'"{key}": {word}' for key, word in words.items()) + "}"


def _replace_number(text: str, rng: np.random.Generator) -> str:
    """Replace or scale a number of an XML attribute."""
    found = list(re.finditer(r'(?<=[" ])-?[\d.]+(?=[" ])', text))
    one = found[int(rng.integers(len(found)))]
    factor = float(rng.choice([0, -1, 1e-9, 0.5, 2, 5, 9, 1e3, 1e30]))
    other = f"{float(one[0]) * factor:g}" if rng.integers(2) else f"{factor:g}"
    return text[: one.start()] + other + text[one.end() :]


FORGED_LOGS: dict[str, Damage] = {
    "forged state": _forge_number("/state"),
    "forged index of commands": _forge_number(
        "/state", [_BEFORE_COMMANDS + 1 + motor * _PER_MOTOR for motor in range(_MOTORS)]
    ),
    "forged dynamics": _forge_number("/dynamics"),
    "forged step": _forge_number("/step"),
    "forged message": _forge_record(
        Message, lambda m, rng: replace(m, data=_replace_byte(m.data, rng))
    ),
    "forged time": _forge_record(Message, _replace_time),
    "forged definition": _forge_record(
        Schema, lambda s, rng: replace(s, data=_replace_byte(s.data, rng))
    ),
    "forged settings": _forge_attachment(SETTINGS_FILE, _replace_setting),
    "forged model": _forge_attachment(MODEL_FILE, _replace_number),
}
"""Damage to a log's content with matching checksums and hashes, as an attacker could cause it."""
