"""Virtual commissioning: a crane as a plant with the words of drives, behind OPC UA and Modbus.

A program enables the drives, commands speeds, and reads status, encoders, load cell and wind. The
crane stops by its own rules and says why. `words.word_map` is the table of what is exchanged,
`served_crane.ServedCrane` the crane, `serve.run` its clock and servers. It needs the extra serve.
"""
