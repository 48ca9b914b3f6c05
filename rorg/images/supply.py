"""Getting images: what is to be built or pulled is made out, done, and written down."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rorg.images.build import Builder, Listener, build
from rorg.images.identity import renewed
from rorg.images.order import Order, Result
from rorg.images.orders import orders_for
from rorg.images.records import Built, Records
from rorg.images.references import Content, bases_of, references
from rorg.model.catalog import Catalog
from rorg.model.image_names import declared, with_identity
