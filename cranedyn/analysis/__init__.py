"""What a record shows: fits of a swing, amplitudes, settling, and predictions to hold them
against.
"""
