"""Entries of the benchmark that are no functions in Python; `open_source` of a module opens one.

`c_library` calls a shared library by the interface of ``crane_entry.h``, `fmu` steps a unit of FMI,
`onnx_policy` and `sb3_policy` run trained policies, and `opcua` talks to another program. They
share `targets`, where the drives shall be as far as a task says, and `observation`, what a policy
observes.
"""
