"""`optdock ui`: a page in the browser on which start, dock and obstacles are dragged."""
