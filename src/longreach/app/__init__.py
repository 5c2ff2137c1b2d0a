"""What joins the rooms: a recording is estimated, evaluated, and written down."""
