//! `[archive] parquet`: where the network's archive is.

use std::fmt;
use std::path::PathBuf;

use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

use crate::bucket::Bucket;

/// The place to which each night is written as Parquet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NetworkArchive {
    /// A folder, also of a mounted share.
    Folder(PathBuf),
    /// A bucket of an object store.
    Bucket(Bucket),
}

impl<'de> Deserialize<'de> for NetworkArchive {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(EitherPlace)
    }
}

struct EitherPlace;

impl<'de> Visitor<'de> for EitherPlace {
    type Value = NetworkArchive;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a folder in quotes, or a table with `bucket`, `access_key` and `secret_file`")
    }

    fn visit_str<E: de::Error>(self, folder: &str) -> Result<NetworkArchive, E> {
        Ok(NetworkArchive::Folder(folder.into()))
    }

    fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<NetworkArchive, A::Error> {
        Bucket::deserialize(MapAccessDeserializer::new(table)).map(NetworkArchive::Bucket)
    }
}
