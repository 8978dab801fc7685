"""Writes an `Episode` as a bag of ROS 2, without ROS: an MCAP file, or a rosbag2 folder with its metadata.yaml.

CDR bytes and message definitions are those of `rosbags` (ROS 2 Humble; later distributions have the same types).
Foxglove's `mcap` writes the file. `rosbags` writes the folder, with SQLite storage, which every distribution reads.
Both are written under a temporary name and renamed when they are complete.
"""

import errno
import os
import shutil
import sqlite3
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from taichi_sim.errors import UserError
from taichi_sim.visualisation.recording.east_north_up import FJORD, Origin
from taichi_sim.visualisation.recording.episode import Episode
from taichi_sim.visualisation.recording.ros.messages import EPOCH_S, Builder, Messages, Topic

if TYPE_CHECKING:
    from rosbags.interfaces import Qos
    from rosbags.typesys.store import Typestore

PACKAGES = ("rosbags", "mcap")


class BagError(UserError, ValueError):
    """A bag cannot be written; the message says what to do."""


def check_bag(path: Path, *, folder: bool, origin: Origin = FJORD) -> None:
    """Refuse a path that cannot be written, before an episode is simulated."""
    check_messages(str(path), origin)
    if not path.parent.is_dir():
        raise BagError(f"{path}: there is no folder {path.parent}")
    if folder and path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise BagError(f"{path} exists already: remove it, or give another --out")
    if not folder and path.is_dir():
        raise BagError(f"{path} is a folder: give another --out")


def check_messages(what: str, origin: Origin) -> None:
    """Refuse `what` without the packages of messages, or with an origin that is no place."""
    if missing := [name for name in PACKAGES if find_spec(name) is None]:
        raise BagError(f'{what}: it needs {" and ".join(missing)}: pip install "taichi-sim[ros]"')
    if not (-90 < origin.latitude < 90 and -180 <= origin.longitude <= 180):
        raise BagError(
            f"origin {origin.latitude:g} {origin.longitude:g}: a latitude is between -90 and 90 degrees, a longitude "
            "from -180 to 180"
        )


def write_mcap(episode: Episode, file: Path, *, origin: Origin = FJORD, show_progress: bool = False) -> Path:
    """Write `episode` as an MCAP file, which replaces an old one."""
    check_bag(file, folder=False, origin=origin)
    from mcap.writer import Writer
    from rosbags.rosbag2.metadata import dump_qos_v8

    typestore, messages = messages_of(episode, origin)
    with _beside(file) as part:
        with part.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros2", library="taichi-sim")
            writer.add_metadata("taichi-sim", _about(episode, origin))
            channels, schemas = {}, {}
            for topic in messages.topics:
                if topic.type not in schemas:
                    text, _ = typestore.generate_msgdef(topic.type, ros_version=2)
                    schemas[topic.type] = writer.register_schema(topic.type, "ros2msg", text.encode())
                qos = {"offered_qos_profiles": dump_qos_v8([_qos(topic.latched)])}
                channels[topic] = writer.register_channel(topic.name, "cdr", schemas[topic.type], qos)
            for topic, stamp, data in _serialised(messages, typestore, show_progress):
                writer.add_message(channels[topic], log_time=stamp, publish_time=stamp, data=data)
            writer.finish()
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, file)
    return file


def write_rosbag2(episode: Episode, folder: Path, *, origin: Origin = FJORD, show_progress: bool = False) -> Path:
    """Write `episode` as a rosbag2 folder, which must not exist yet, or be empty."""
    check_bag(folder, folder=True, origin=origin)
    from rosbags.rosbag2 import StoragePlugin, Writer

    typestore, messages = messages_of(episode, origin)
    with _beside(folder) as part:
        whole = part / folder.name  # the storage is named after its folder
        with Writer(whole, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
            for key, value in _about(episode, origin).items():
                writer.set_custom_data(key, value)
            connections = {
                topic: writer.add_connection(
                    topic.name, topic.type, typestore=typestore, offered_qos_profiles=[_qos(topic.latched)]
                )
                for topic in messages.topics
            }
            for topic, stamp, data in _serialised(messages, typestore, show_progress):
                writer.write(connections[topic], stamp, data)
        if folder.is_dir():
            folder.rmdir()
        os.rename(whole, folder)
    return folder


def messages_of(episode: Episode, origin: Origin) -> tuple["Typestore", Messages]:
    """A typestore, and the messages of `episode` in its types."""
    from rosbags.typesys import Stores, get_typestore

    typestore = get_typestore(Stores.ROS2_HUMBLE)
    return typestore, Messages(episode, origin, Builder(typestore))


def _serialised(messages: Messages, typestore: "Typestore", show_progress: bool) -> Iterator[tuple[Topic, int, bytes]]:
    """Topic, stamp (ns) and bytes of every message."""
    for step, stamp in enumerate(tqdm(messages.stamps, desc="bag", unit="step", disable=not show_progress)):
        for topic, message in messages.frame(step):
            yield topic, stamp, bytes(typestore.serialize_cdr(message, topic.type))


def _qos(latched: bool) -> "Qos":
    """Reliable quality of service; `latched`, for /tf_static, also reaches late subscribers."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=QosTime(0, 0),
        lifespan=QosTime(0, 0),
        liveliness=QosLiveliness.SYSTEM_DEFAULT,
        liveliness_lease_duration=QosTime(0, 0),
        avoid_ros_namespace_conventions=False,
    )


def _about(episode: Episode, origin: Origin) -> dict[str, str]:
    """Metadata of a bag, as text."""
    return {
        "episode": episode.name,
        "origin_latitude_deg": repr(float(origin.latitude)),
        "origin_longitude_deg": repr(float(origin.longitude)),
        "epoch_s": str(EPOCH_S),
        "config": episode.config_text,
    }


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A temporary name beside `path`, removed afterwards in any case."""
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        yield part
    except (OSError, sqlite3.Error) as fault:
        number, reason = (fault.errno, fault.strerror) if isinstance(fault, OSError) else (errno.EIO, str(fault))
        raise OSError(number, f"bag not written: {reason}", str(path)) from fault
    finally:
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)
