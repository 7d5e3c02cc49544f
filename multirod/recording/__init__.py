"""Recordings for the Rerun viewer: a finished ``History``, or a control loop while it runs.

Entities (``[instance_k]`` only where there is a batch axis). ``ROD`` is a rod's name, or ``rod_k``; in ``ParallelRods`` it is
``LEG`` for a leg that is one rod, and ``LEG/ROD`` for a tube, with ``LEG`` a leg's name, or ``leg_k``, counted from 1:

=========================================  ==============================================================================
``/description``                           what was run, units and scales, as Markdown
``/world/base[_k][/LEG]``                  base frames; of a ``Network`` those of the rods that stand on the ground
``/world/[instance_k/]rods/ROD``           shape: one capsule between two nodes
``/world/[instance_k/]tip``                frame of the end effector, which may be a platform's
``/world/[instance_k/]tip_path``           a stroke a sample, from the tip before
``/world/[instance_k/]platform``           a plate through the attachments, for robots that have a platform
``/world/[instance_k/]bodies/BODY``        the same of each body of a ``Network``, with its frame; below it its ``name``
``/world/[instance_k/]loads/NAME``         ``tip_force``, ``follower_force``, arrows in newtons, ``tip_moment``,
                                           ``follower_moment`` in newton metres, from where they act; of a ``Network``
                                           ``force/BODY``, ``moment/BODY``, or of the rod whose tip is free
``/world/[instance_k/]loads/along[/ROD]``  all that acts along a rod, as one force; ``weight/BODY`` that of a body or platform
``/world/[instance_k/]reference/...``      shape and tip path of the reference
``/error/boundary[_log10][/instance_k]``   ``residual`` [1/m]
``/error/blocks[_log10][/instance_k]``     the same of each leg and of the platform, a series each, where there are several; of
                                           a ``Network`` of each rod and of all bodies
``/error/tip_mm[_log10][/instance_k]``     distance of the tip from the reference's [mm]
``/conditioning/...[/instance_k]``         ``condition[_log10]``, ``smallest_singular_value[_log10]``
``/solver/...[/instance_k]``               ``step_time_ms[_log10]``, ``iterations``, ``integrations``
``/inputs/NAME[/instance_k]``              every input that was given as numbers, a series a component or rod
``/PROFILE/...``                           ``curvature``, ``moment``, ``force``, ``strain``, ``difference`` along rods, as drawn
``/world/[instance_k/]names/ROD``          names of rods
``/world/[instance_k/]failed/...``         where samples failed, or are an event: the last shape before, and the status in words
``/legend``                                what colours mean, and the scale of arrows
``/status[/instance_k]``                   name of ``Status``, one row a change
=========================================  ==============================================================================

Every row carries two timelines, ``step`` (sample number) and ``time`` [s]. Scalars are float64 and equal the history's
values; geometry is float32. A failed sample has NaN scalars and no geometry.

``recorder`` is where to begin. ``samples`` makes the blocks that are written together; ``figure`` says how a robot is drawn,
``stage`` what is fixed when the recording begins; ``writer`` sends rows (``columns``) and what never changes (``style``,
``layout``).
"""

from multirod.recording.recorder import Recorder, save

__all__ = ["Recorder", "save"]
