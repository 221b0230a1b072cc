"""The winding scene: a yarn drawn through a traversing guide onto a rotating bobbin."""
