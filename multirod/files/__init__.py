"""Files: what a robot, its inputs and its results are written to, and read back from (``docs/files.md``).

=================  ====================================================  ======================================================
ending             what                                                  to be read by
=================  ====================================================  ======================================================
``.toml``          robots and inputs, as text with units                 ``mr.load``, and whoever opens it
``.npz``           robots, inputs, solutions, histories, complete        ``mr.load``, ``numpy.load``
``.csv``           centrelines of a solution or history                  spreadsheets
``.nc``            what ``to_xarray`` makes of one                       ``xarray.open_dataset``, and all that reads netCDF
``.glb`` ...       what ``to_mesh`` makes of one                         viewers and editors of meshes
``.rrd``           a history as a recording                              the Rerun viewer
=================  ====================================================  ======================================================

``saving`` and ``loading`` are where to begin. ``kinds`` says what a file may hold, ``describing`` makes tables of that and
``making`` makes it of tables; ``text`` and ``archive`` write tables; ``results`` makes tables of solutions; ``centrelines``,
``datasets`` and ``meshes`` are what the others write. Every file is written whole or not at all (``whole``), and nothing is
pickled.
"""

from multirod.files.loading import load

__all__ = ["load"]
