"""One backbone: its boundary problem (``problem``), segments of it (``segments``), and the kernels that integrate it
(``kernels``)."""
