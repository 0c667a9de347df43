"""What comes from outside, read with bounds: every file, and every text that is JSON, TOML, CSV or DBC.

Whoever opens a file here may have been given the wrong one, a torn one, or one that was made to do harm. So nothing is
read without a limit (bytes, what a gzip stream expands to, nesting, digits, columns), what the formats of the parsers
let through but no reader of numbers can use is refused (NaN, lone surrogates, a key given twice), and whatever is wrong
is an `InputError` that names file, place and what to do. The parsers of the library and of others are called in this
package alone; a test holds the rest of the sources to that.

    files      bytes of a file, through gzip, with limits
    texts      text from bytes: encodings
    documents  JSON, lines of JSON, TOML
    messages   JSON that a pydantic model describes
    table      the header and the rows of a CSV file
    columnar   Parquet, Arrow and MCAP
    large      the rows of a large text by pyarrow's parser
    arrays     NumPy's arrays and archives; what archives and MATLAB files unpack to
    dbc        what a DBC file may say before its parser sees it
"""

from highside.reading.dbc import check_dbc
from highside.reading.documents import (
    MALFORMED,
    instant,
    parse_json,
    parse_json_lines,
    parse_toml,
    read_document,
    read_toml,
)
from highside.reading.files import (
    CERTIFICATES_MAX,
    SECRET_MAX,
    allow_bytes,
    open_binary,
    open_file,
    read_bytes,
    read_named,
)
from highside.reading.messages import parse_message, text_member
from highside.reading.table import csv_header, csv_rows
from highside.reading.texts import decode_foreign, decode_text

__all__ = [
    "CERTIFICATES_MAX",
    "MALFORMED",
    "SECRET_MAX",
    "allow_bytes",
    "check_dbc",
    "csv_header",
    "csv_rows",
    "decode_foreign",
    "decode_text",
    "instant",
    "open_binary",
    "open_file",
    "parse_json",
    "parse_json_lines",
    "parse_message",
    "parse_toml",
    "read_bytes",
    "read_document",
    "read_named",
    "read_toml",
    "text_member",
]
