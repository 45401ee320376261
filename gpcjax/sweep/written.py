"""Numbers as a flag or a file has them. Standard library only."""

import re
import sys


class Written(float):
    """A number as a flag or a file has it, which messages repeat: 1e-400 would read 0.0 in them."""

    text: str

    def __new__(cls, text: str) -> "Written":
        """Of a text that `float` takes."""
        number = super().__new__(cls, text)
        number.text = text
        return number

    def __repr__(self) -> str:
        return self.text

    @property
    def lost(self) -> bool:
        """Whether float64 has zero in its place, or a subnormal number, which processors may flush to zero."""
        mantissa = re.split("[eE]", self.text)[0]
        return abs(self) < sys.float_info.min and any(digit in mantissa for digit in "123456789")
