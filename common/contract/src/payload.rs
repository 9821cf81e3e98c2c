//! What every payload of the bus is.

/// A value that travels on the bus: plain data with a name that the contract's table and golden samples use.
pub trait Payload:
    schemars::JsonSchema + serde::Serialize + serde::de::DeserializeOwned + Send + Sync + Clone + 'static
{
    /// Name of the payload in `docs/bus.md` and of its golden sample.
    const NAME: &'static str;
}
