//! No code: this crate only names features of shared dependencies, so that every build has the same (`scripts/features`).
