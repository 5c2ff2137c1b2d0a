"""The belief over where the base is and how it moves: a planar extended Kalman filter (3.27)-(3.29) on the manifold."""
