"""What the import hook of conftest checks annotations with."""

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""An int will do where a float is wanted, as for the static checker."""
