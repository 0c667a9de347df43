"""Topics beside one another in a container: an encoder is joined, folders are bags, what is not read is named."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from foreign_containers import protobuf_mcap, ros2_db3
from foreign_session import session
from mcap.writer import Writer as McapWriter

import highside
from highside.errors import InputError


def test_an_encoder_of_the_same_bag_is_joined_with_what_is_said_of_its_column(tmp_path: Path) -> None:
    s = session()
    (tmp_path / "x.db3").write_bytes(ros2_db3(s))
    found = highside.import_recording(
        tmp_path / "x.db3", join=["/encoder"], reference_mapping={"rotor_deg": "data:deg"}, accept=True
    )
    np.testing.assert_allclose(found["rotor_deg"], s.tf_deg, rtol=0, atol=1e-6)
    with pytest.raises(InputError, match=r"has no table '/wheel'; .*/encoder"):
        highside.import_recording(tmp_path / "x.db3", join=["/wheel"])


def test_the_folder_of_a_bag_is_the_file_in_it(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (bag / "bag_0.db3").write_bytes(ros2_db3(session()))
    assert highside.import_recording(bag).n == session().n
    (bag / "bag_1.db3").write_bytes(b"")
    with pytest.raises(InputError, match="is a bag of 2 files"):
        highside.import_recording(bag)


def test_a_topic_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    out = io.BytesIO()
    writer = McapWriter(out)
    writer.start()
    schema = writer.register_schema(name="own/msg/Odd", encoding="flatbuffer", data=b"")
    channel = writer.register_channel(schema_id=schema, topic="/odd", message_encoding="flatbuffer")
    writer.add_message(channel, log_time=1, publish_time=1, data=b"x")
    writer.finish()  # type: ignore[no-untyped-call]
    (tmp_path / "x.mcap").write_bytes(out.getvalue())
    with pytest.raises(InputError, match=r"no message that can be read; it has /odd \(own/msg/Odd\)"):
        highside.import_recording(tmp_path / "x.mcap")


@pytest.mark.parametrize("make", [ros2_db3, protobuf_mcap])
def test_damage_is_refused_in_one_line(tmp_path: Path, make: object) -> None:
    assert callable(make)
    data = make(session())
    rng = np.random.default_rng(3)
    for trial in range(8):
        spoilt = bytearray(data[: int(len(data) * (0.3 + 0.1 * trial))])
        for place in rng.integers(0, len(spoilt), 30):
            spoilt[place] = int(rng.integers(256))
        (tmp_path / "x").write_bytes(spoilt)
        try:
            highside.import_recording(tmp_path / "x", accept=True)
        except InputError as error:
            assert str(error).startswith(str(tmp_path))  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
