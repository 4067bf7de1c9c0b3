"""A crane in any kind of number: floats, rows of floats, symbols, values of compiled code."""
