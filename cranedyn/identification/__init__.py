"""Identification of a crane from records.

Parameters of cable, load, damping, drives and sensors are estimated with confidence intervals; the
identified crane is a twin to try controllers on::

    prior = Prior()
    records = [load_record(file, prior.crane) for file in files]
    estimate = identify(Model.of(prior, records))
    print(estimate.value("l_offset"), estimate.margin("l_offset"))
"""

from cranedyn.identification.checked_record import Record, load_record
from cranedyn.identification.estimate import Estimate, identify
from cranedyn.identification.parameters import Parameter
from cranedyn.identification.preflight import Preflight, preflight
from cranedyn.identification.prior import Prior
from cranedyn.identification.record_prediction import Model
from cranedyn.identification.twin import Twin, read_twin, twin_of

__all__ = [
    "Estimate",
    "Model",
    "Parameter",
    "Preflight",
    "Prior",
    "Record",
    "Twin",
    "identify",
    "load_record",
    "preflight",
    "read_twin",
    "twin_of",
]
