"""Sans-IO framing and decoding: bytes or CAN frames in, `Frame`s out, and counts that add up."""
