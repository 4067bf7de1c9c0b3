"""A crane found from its records: what a record says of cable, load, damping, drives and sensors,
how sure that is, and the crane that follows.

Records in, numbers with intervals out, a twin to try controllers on::

    known = Known()
    records = [load_record(file, known.crane) for file in files]
    found = identify(Model.of(known, records))
    print(found.value("l_offset"), found.margin("l_offset"))
"""

from cranedyn.identification.estimate import Estimate, identify
from cranedyn.identification.known import Known
from cranedyn.identification.model import Model
from cranedyn.identification.parameters import Parameter
from cranedyn.identification.preflight import Preflight, preflight
from cranedyn.identification.reading import load_record
from cranedyn.identification.record import Record
from cranedyn.identification.twin import Twin, read_twin, twin_of

__all__ = [
    "Estimate",
    "Known",
    "Model",
    "Parameter",
    "Preflight",
    "Record",
    "Twin",
    "identify",
    "load_record",
    "preflight",
    "read_twin",
    "twin_of",
]
