"""Entries that are policies in ONNX, run by ONNX Runtime; nothing in the file is code of Python.

The policy has one input, the observation of `cranedyn.benchmark.entries.observation`, of shape
(k,) or (1, k) in single or double precision. Its first output is the action, of m numbers.
"""

from __future__ import annotations

import numpy as np

from cranedyn.benchmark.entries.observation import Observer, check_sizes
from cranedyn.benchmark.entry import Briefing, Entry, Opened
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, DataError, format_error

try:
    import onnxruntime
except ModuleNotFoundError as error:
    raise CraneError(
        "Policies in ONNX need ONNX Runtime, which is not installed: pip install 'cranedyn[onnx]'."
    ) from error

_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Types of NumPy by those of inputs in ONNX."""

_ONLY_ERRORS = 3
"""Level of the log of ONNX Runtime."""


def open_source(source: str) -> Opened:
    """Load a policy.

    Raises:
        DataError: If it cannot be loaded, or has other inputs.
    """
    options = onnxruntime.SessionOptions()
    # One thread, as every entry has, and so one order of additions.
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = _ONLY_ERRORS
    try:
        session = onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime has a dozen classes of errors without a common one
        raise DataError(f"{source} is no policy in ONNX: {format_error(error)}") from error
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(one.name for one in inputs)
        raise DataError(
            f"{source} has the inputs {names}; a policy has one, the observation. Put other inputs "
            "into the file as constants."
        )
    (observed,) = inputs
    if observed.type not in _TYPES or len(observed.shape) not in (1, 2):
        raise DataError(
            f"The input {observed.name} of {source} is a {observed.type} of shape "
            f"{observed.shape}; allowed is a tensor of float or double of shape (k,) or (1, k)."
        )
    width = observed.shape[-1]
    action_name = session.get_outputs()[0].name
    shape = (1, -1) if len(observed.shape) == 2 else (-1,)

    def make(briefing: Briefing) -> Entry:
        observer = Observer(briefing)
        # A dimension without a number is named by a text.
        check_sizes(source, observer, width if isinstance(width, int) else len(observer.names))

        def rates(reading: SensorReading) -> np.ndarray:
            observation = observer.observe(reading).astype(_TYPES[observed.type]).reshape(shape)
            (action,) = session.run([action_name], {observed.name: observation})
            return observer.rates(action)

        return rates

    return make
