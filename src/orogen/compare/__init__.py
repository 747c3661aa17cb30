"""Measuring instruments: the true surface, screen-space errors, cracks and standard views.

They read depth pictures and height arrays and share no code with what draws them.
"""
