"""Why a command refuses something: of a fleet, of rotation, and of what they read beside the lists of `refusals`. Told
on the terminal by `cli.options.refusal`.
"""

from __future__ import annotations

from highside.words.marks import said_later
from highside.words.sentences_of_others import OTHERS
from highside.words.sentences_of_terminal import TERMINAL

FLEET = (
    said_later("cannot be reached: %(why)s"),
    said_later("is no certificate that can be used (%(why)s)"),
    said_later("give a PEM file"),
    said_later("has no sequence number"),
    said_later("holds no recording"),
    said_later("files that end in %(endings)s"),
    said_later("a catalogue has one row a recording: uri, tool, lot, ..."),
    said_later("a catalogue has a header with the column uri"),
    said_later("names %(name)s twice"),
    said_later("keep one of the rows"),
    said_later("name the recording, or take the row out"),
    said_later("%(codec)s: a fleet reads Recordings, not the wire"),
    said_later(
        "run `highside decode %(file)s --codec %(codec)s -o REC.csv.gz`, name the result and leave the cell empty"
    ),
    said_later("%(cells)s cells under %(names)s names"),
    said_later("correct the row"),
    said_later("cannot be listed: %(why)s"),
    said_later("is no place that can be read: %(why)s"),
    said_later("a fleet needs fsspec, which is not installed"),
    said_later("a fleet needs dask.distributed, which is not installed"),
    said_later("a fleet needs pyarrow, which is not installed"),
    said_later("a summary needs duckdb, which is not installed"),
    said_later("holds no results"),
    said_later("run highside fleet diagnose first"),
    said_later("is damaged: its end is missing"),
    said_later("is damaged: %(why)s"),
    said_later("remove it, run again"),
    said_later("holds no calibration record that can be used"),
    said_later("name the folder of a store"),
    said_later("is not a folder"),
    said_later("%(limit)s is no limit"),
    said_later("between 0 and 90"),
    said_later("changed while it was read"),
    said_later("run it again when it is written"),
    said_later("is longer than %(most)s bytes"),
    said_later("see --max-bytes"),
    said_later("cannot be fetched: %(why)s"),
    said_later("see that the place can be read"),
    said_later("has no processes"),
    said_later("start dask workers there"),
    said_later("the process %(process)s does not see %(folder)s"),
    said_later("name a folder that all machines of the cluster see by TMPDIR"),
    said_later("the process %(process)s has highside %(version)s, this is %(own)s"),
    said_later("runs %(low)s to %(high)s of rows ended %(count)s processes of the cluster"),
    said_later("give its processes more memory"),
    said_later("does not determine %(names)s"),
    said_later("leave this record out"),
    said_later("%(name)s is no column of the catalogue"),
)
"""Of a catalogue of recordings, its results and a cluster (`fleet`)."""

ROTATIONS = (
    said_later("its schema is %(found)s, this version reads %(known)s: fit the recording again with rotation fit"),
    said_later("its content is not the one its id was made from: it was changed; fit again"),
    said_later("its unit is %(found)s, not %(known)s"),
    said_later("give a file made by rotation fit"),
    said_later("this compensation depends on the rotor rate"),
    said_later("%(method)s has no rate terms"),
    said_later("use polynomial9 or auto"),
    said_later("%(rows)s rows cannot determine %(count)s parameters"),
    said_later("give more than %(rows)s rows"),
    said_later("rate terms need the rotor rate"),
    said_later("give rotor_rate_dps or leave %(option)s out"),
    said_later("%(count)s rate terms"),
    said_later("0, 1 or 2"),
    said_later("no angle is beyond %(angle)s: these are radians"),
    said_later("give degrees"),
    said_later("jumps by %(angle)s between two rows: no degrees (counts of an encoder?)"),
    said_later("many rows lie more than %(angle)s deg from the row before: not in order, or sampled too slowly"),
    said_later("sort by time, or record faster"),
    said_later("%(size)s is no small error"),
    said_later("give decoded - true in arcmin"),
    said_later("%(rows)s rows are too few for a curve over the turn"),
    said_later("has no meaning with a compensation that is fitted"),
    said_later("has none of the errors this compensation is for (%(names)s)"),
    said_later("give %(names)s, or inc_deg with tf_deg or azi_deg"),
    said_later("time goes back"),
    said_later("has none of %(names)s"),
)
"""Of a recording with a rotor angle, and of a compensation (`rotation`, `api.rotation`)."""

MODELS = (said_later('add a table [motion] with kind = "poses"'),)
"""Of a model (`config.model`)."""

COMMANDS = (*FLEET, *ROTATIONS, *MODELS, *TERMINAL, *OTHERS)
