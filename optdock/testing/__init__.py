"""What tests of plugins need: the contract suites, and drives and motions to try them on."""
