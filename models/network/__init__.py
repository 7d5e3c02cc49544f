"""Rods and bodies in a graph (``graph``): what joins them (``joining``), rods as elements between bodies (``elements``), the
boundary problem of both (``problem``), and its second variation (``stability``).
"""
