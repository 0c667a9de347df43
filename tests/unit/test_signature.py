"""Signatures of records and files: what a change, a stranger's key or a missing signature leads to."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_record import NOW, make, reason_of

from highside.calibration.record import CalibrationRecord, RecordReason, content_id, parse_record, to_utc, verify
from highside.calibration.signature import (
    FILE,
    RECORD,
    KeyLockedError,
    Signature,
    SignatureError,
    SigningKey,
    TrustedKeys,
    UnknownKeyError,
    new_key,
    parse_private_key,
    parse_trusted_keys,
    private_pem,
)
from highside.errors import InputError, Refused
from highside.recording.calibration_store import CalibrationStore, load_active, load_record_file
from highside.recording.keys import PASSPHRASE, check_file, read_key, read_trusted_keys, sign_file, write_key

TIME = to_utc(NOW)
DIGEST = "ab" * 32


@pytest.fixture(scope="module")
def lab() -> SigningKey:
    return new_key("Laboratory 1")


@pytest.fixture(scope="module")
def stranger() -> SigningKey:
    return new_key("Laboratory 1")  # the same name, and another key


@pytest.fixture(scope="module")
def trusted(lab: SigningKey) -> TrustedKeys:
    return parse_trusted_keys(f"# those whom this rig trusts\n\n{lab.public_line}\n")


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    return make()


def test_a_signed_record_keeps_its_id_and_reads_back(
    lab: SigningKey, trusted: TrustedKeys, record: CalibrationRecord
) -> None:
    again = parse_record(record.signed(lab, now_s=NOW).to_json())
    assert again.id == record.id
    assert again.check_signature(trusted) == "Laboratory 1"
    verify(again, tool_id="tool-7", serial="42", now_s=NOW, trusted=trusted)


def test_a_record_rehashed_after_a_change_is_tampered_unsigned_or_untrusted(
    lab: SigningKey, stranger: SigningKey, trusted: TrustedKeys, record: CalibrationRecord
) -> None:
    """Whoever can write the file can make its hash right again; without the key they get no further."""
    data = json.loads(record.signed(lab, now_s=NOW).to_json())
    signature = data.pop("signature")
    del data["id"]
    data["environment"]["operator"] = "somebody else"
    forged = {"id": content_id(data), **data}
    unsigned = parse_record(json.dumps(forged))
    kept = parse_record(json.dumps(forged | {"signature": signature}))
    own = unsigned.signed(stranger, now_s=NOW)
    # the stranger's signature under the laboratory's key id
    posed = own.signature.to_dict() | {"key": lab.fingerprint} if own.signature else {}
    false = parse_record(json.dumps(forged | {"signature": posed}))
    for found, reason in (
        (unsigned, RecordReason.UNSIGNED),
        (kept, RecordReason.TAMPERED),
        (own, RecordReason.UNTRUSTED),
        (false, RecordReason.TAMPERED),
    ):
        verify(found, tool_id="tool-7")  # nothing but the signature tells
        assert reason_of(lambda found=found: verify(found, tool_id="tool-7", trusted=trusted)) is reason


@pytest.mark.parametrize(
    "change",
    [
        {"value": "AAAA"}, {"value": "?"}, {"value": 7}, {"scheme": "highside.signature/2"}, {"algorithm": "none"},
        {"key": None}, {"time": "yesterday"}, {"signer": "a\nb"}, {"signer": "x" * 300},
    ],
)  # fmt: skip
def test_a_signature_that_is_none_is_refused_by_name(
    lab: SigningKey, record: CalibrationRecord, change: dict[str, Any]
) -> None:
    data = json.loads(record.signed(lab, now_s=NOW).to_json())
    data["signature"] |= change
    assert reason_of(lambda: parse_record(json.dumps(data))) is RecordReason.TAMPERED


@given(st.data())
def test_no_changed_character_of_a_signature_passes(data: st.DataObject) -> None:
    key = _KEY
    signature = key.sign(RECORD, DIGEST, TIME).to_dict()
    name = data.draw(st.sampled_from(["key", "time", "value"]))
    at = data.draw(st.integers(0, len(signature[name]) - 1))
    other = data.draw(st.characters(min_codepoint=33, max_codepoint=126).filter(lambda c: c != signature[name][at]))
    changed = signature | {name: signature[name][:at] + other + signature[name][at + 1 :]}
    with pytest.raises((SignatureError, UnknownKeyError, ValueError)):
        parse_trusted_keys(key.public_line).check(Signature.from_dict(changed), RECORD, DIGEST)


_KEY = new_key("property")


def test_a_signature_of_a_file_is_none_of_a_record(lab: SigningKey, trusted: TrustedKeys) -> None:
    with pytest.raises(SignatureError):
        trusted.check(lab.sign(FILE, DIGEST, TIME), RECORD, DIGEST)
    with pytest.raises(SignatureError):
        trusted.check(lab.sign(FILE, DIGEST, TIME), FILE, "cd" * 32)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no key"),
        ("# only a remark\n", "holds no key"),
        ("hello\n", "line 1"),
        ("\nssh-ed25519 AAAA Name\n", "line 2"),
        ("ssh-rsa AAAAB3NzaC1yc2EAAAADAQABAAAAgQ== Name\n", "line 1"),
    ],
)
def test_a_file_of_trusted_keys_is_refused_by_line(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_trusted_keys(text, where="keys")


def test_a_trusted_key_must_say_whose_it_is(lab: SigningKey) -> None:
    with pytest.raises(InputError, match="whose key"):
        parse_trusted_keys(" ".join(lab.public_line.split()[:2]))


def test_a_key_on_the_disk_is_its_owners_alone_and_never_overwritten(tmp_path: Path, lab: SigningKey) -> None:
    path = tmp_path / "lab.key"
    public = write_key(path, lab)
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_key(path).fingerprint == lab.fingerprint
    assert list(read_trusted_keys(public).keys) == [lab.fingerprint]
    before = path.read_bytes()
    with pytest.raises(InputError, match="is there already"):
        write_key(path, new_key("another"))
    assert path.read_bytes() == before
    path.chmod(0o644)
    with pytest.raises(InputError, match="read by others"):
        read_key(path)


def test_a_locked_key_wants_its_passphrase(tmp_path: Path, lab: SigningKey, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "lab.key"
    write_key(path, lab, b"a long secret")
    monkeypatch.delenv(PASSPHRASE, raising=False)
    with pytest.raises(InputError, match=PASSPHRASE):
        read_key(path)
    with pytest.raises(InputError, match="passphrase is wrong"):
        read_key(path, ask=lambda: "another")
    assert read_key(path, ask=lambda: "a long secret").fingerprint == lab.fingerprint
    monkeypatch.setenv(PASSPHRASE, "a long secret")
    assert read_key(path).name == "Laboratory 1"
    with pytest.raises(KeyLockedError):
        parse_private_key(private_pem(lab, b"x"), "x")


def test_a_public_key_of_another_beside_a_private_one_is_refused(
    tmp_path: Path, lab: SigningKey, stranger: SigningKey
) -> None:
    public = write_key(tmp_path / "lab.key", lab)
    public.write_text(stranger.public_line + "\n")
    with pytest.raises(InputError, match="is not the public key"):
        read_key(tmp_path / "lab.key")


def test_fingerprint_and_keys_are_those_of_openssh(tmp_path: Path, lab: SigningKey) -> None:
    if shutil.which("ssh-keygen") is None:
        if os.environ.get("CI") == "true":
            pytest.fail("ssh-keygen is not installed, and CI must not skip this test")
        pytest.skip("needs ssh-keygen (apt-get install openssh-client)")
    public = write_key(tmp_path / "lab.key", lab)
    printed = subprocess.run(["ssh-keygen", "-lf", public], capture_output=True, text=True, check=True).stdout
    assert lab.fingerprint in printed
    made = tmp_path / "ssh"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "Bench 3", "-f", made], check=True)
    key = read_key(made)
    assert key.name == "Bench 3"
    read_trusted_keys(tmp_path / "ssh.pub").check(key.sign(RECORD, DIGEST, TIME), RECORD, DIGEST)


def test_the_store_keeps_signatures_and_uses_only_what_is_trusted(
    tmp_path: Path, lab: SigningKey, stranger: SigningKey, trusted: TrustedKeys, record: CalibrationRecord
) -> None:
    store = CalibrationStore(tmp_path)
    store.activate(record, now_s=NOW)
    assert load_active(tmp_path, tool_id="tool-7").cal_id == record.id
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7", trusted=trusted)) is RecordReason.UNSIGNED
    assert store.add(record.signed(lab, now_s=NOW))
    assert not store.add(record)  # a signature is never taken away
    assert load_active(tmp_path, tool_id="tool-7", trusted=trusted).cal_id == record.id
    other = make(seed=1).signed(stranger, now_s=NOW)
    assert reason_of(lambda: store.activate(other, now_s=NOW, trusted=trusted)) is RecordReason.UNTRUSTED
    store.activate(other, now_s=NOW)
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7", trusted=trusted)) is RecordReason.UNTRUSTED
    file = tmp_path / "records" / f"{record.id}.json"
    assert load_record_file(file, tool_id="tool-7", trusted=trusted).cal_id == record.id


def test_any_file_is_signed_beside_it(
    tmp_path: Path, lab: SigningKey, stranger: SigningKey, trusted: TrustedKeys
) -> None:
    file = tmp_path / "certificate.html"
    file.write_bytes(os.urandom(3000))
    with pytest.raises(Refused, match=r"no signature certificate\.html\.sig"):
        check_file(file, trusted)
    beside = sign_file(file, lab, now_s=NOW)
    assert check_file(file, trusted)[0] == "Laboratory 1"
    sign_file(file, stranger, now_s=NOW)
    with pytest.raises(Refused, match=rf"{file.name}: signed with the key SHA256:.* not trusted here"):
        check_file(file, trusted)
    sign_file(file, lab, now_s=NOW)
    file.write_bytes(file.read_bytes() + b" ")
    with pytest.raises(Refused, match="is not of this content"):
        check_file(file, trusted)
    for damaged in (b"", b"{", b"\xff", b"[" * 90_000, b'{"scheme": 1}', b"x" * 200_000):
        beside.write_bytes(damaged)
        with pytest.raises((Refused, InputError)):
            check_file(file, trusted)


def test_a_time_in_other_digits_is_no_time() -> None:
    """What is signed is ASCII: other digits would fail in the check itself, past the errors that it names."""
    signed = new_key("Laboratory").sign(FILE, "0" * 64, "2026-11-21T02:40:00Z").to_dict()
    assert Signature.from_dict(signed).time == "2026-11-21T02:40:00Z"
    with pytest.raises(ValueError, match="time is not of the form"):
        Signature.from_dict(signed | {"time": "\u0662\u0660\u0662\u0666-11-21T02:40:00Z"})
