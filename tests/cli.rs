//! The `holovol` command as its users meet it.
