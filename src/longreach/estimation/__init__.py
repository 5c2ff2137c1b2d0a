"""State estimation: the planar filter, the filter in space, and the buffer by which both take late readings."""
