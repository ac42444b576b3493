"""`optdock ui`: a scenario that is edited in the browser and planned after every change."""
