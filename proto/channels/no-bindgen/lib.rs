//! Nothing: what would be here is never called.
