//! People's orders: answered once each ([`answering`]), and executed ([`execution`]).

mod answering;
mod execution;
pub mod rows;

pub use self::answering::keep_answering;
pub use self::execution::Telescope;
