//! The errors between a device node and an Alpaca server, by class.

use contract::NoData;

/// Why a call gave nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AlpacaError {
    /// No whole answer came.
    #[error("{fault}: {detail}")]
    Transport {
        /// The kind of failure.
        fault: Fault,
        /// The error of the network.
        detail: String,
    },
    /// The server refused with an HTTP status.
    #[error("HTTP {status}: {body}")]
    Http {
        /// HTTP status.
        status: u16,
        /// Beginning of the body.
        body: String,
    },
    /// The answer is no Alpaca answer.
    #[error("unreadable answer: {0}")]
    Protocol(String),
    /// The answer is the answer to another request.
    #[error("the answer to another request: ClientTransactionID is {got}, expected {asked}")]
    Foreign {
        /// The id of the request.
        asked: u32,
        /// The id of the answer, in words.
        got: String,
    },
    /// The answer has no value.
    #[error("the answer has no Value")]
    NoValue,
    /// The value is of no use, for this reason.
    #[error("{0}")]
    Value(NoData),
    /// The device refused with an ASCOM error.
    #[error("ASCOM error 0x{code:X}: {message}")]
    Ascom {
        /// ASCOM error number, 0x400 to 0xFFF where it is one.
        code: u32,
        /// The message of the driver.
        message: String,
    },
}

/// How the network failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// No whole answer within the deadline; whether it was done is unknown.
    Timeout,
    /// No connection.
    Connect,
    /// The connection broke; whether it was done is unknown.
    Reset,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Timeout => "timeout",
            Self::Connect => "nobody listens at its server's address",
            Self::Reset => "its server closed the connection",
        })
    }
}

impl AlpacaError {
    /// ASCOM NotImplemented.
    pub const NOT_IMPLEMENTED: u32 = 0x400;
    /// ASCOM InvalidValue.
    const INVALID_VALUE: u32 = 0x401;
    /// ASCOM NotConnected.
    pub const NOT_CONNECTED: u32 = 0x407;
    /// ASCOM ActionNotImplemented.
    const ACTION_NOT_IMPLEMENTED: u32 = 0x40C;

    /// No whole answer within `seconds`.
    pub fn timeout(seconds: f64) -> Self {
        Self::Transport { fault: Fault::Timeout, detail: format!("no answer within {seconds} s") }
    }

    /// From the HTTP client's error.
    pub fn from_http(error: &reqwest::Error) -> Self {
        let mut detail = error.to_string();
        let mut cause = std::error::Error::source(error);
        while let Some(inner) = cause {
            detail = inner.to_string();
            cause = inner.source();
        }
        let fault = match () {
            () if error.is_timeout() => Fault::Timeout,
            () if error.is_connect() => Fault::Connect,
            () => Fault::Reset,
        };
        Self::Transport { fault, detail }
    }

    /// No answer, or no whole answer, came back.
    pub fn is_transport(&self) -> bool {
        matches!(self, Self::Transport { .. })
    }

    /// No whole answer came in time.
    pub fn is_timeout(&self) -> bool {
        matches!(self, Self::Transport { fault: Fault::Timeout, .. })
    }

    /// Did the call perhaps reach the device, though no answer to it came?
    pub fn is_unknown_outcome(&self) -> bool {
        matches!(self, Self::Transport { fault: Fault::Timeout | Fault::Reset, .. } | Self::Foreign { .. })
    }

    /// The device itself refused.
    pub fn is_ascom(&self) -> bool {
        matches!(self, Self::Ascom { .. }) || self.is_not_implemented()
    }

    /// The answer is the answer to another request.
    pub fn is_foreign(&self) -> bool {
        matches!(self, Self::Foreign { .. })
    }

    /// The device knows no such parameter.
    pub fn is_invalid_value(&self) -> bool {
        matches!(self, Self::Ascom { code: Self::INVALID_VALUE, .. })
    }

    /// The device reports that it is not connected.
    pub fn is_not_connected(&self) -> bool {
        matches!(self, Self::Ascom { code: Self::NOT_CONNECTED, .. })
    }

    /// The device does not have this; it is not asked again until it is connected anew.
    pub fn is_not_implemented(&self) -> bool {
        match self {
            Self::Ascom { code, .. } => matches!(*code, Self::NOT_IMPLEMENTED | Self::ACTION_NOT_IMPLEMENTED),
            Self::Http { status, .. } => matches!(status, 400 | 404 | 405 | 501),
            Self::Transport { .. } | Self::Protocol(_) | Self::Foreign { .. } | Self::NoValue | Self::Value(_) => false,
        }
    }

    /// What a person is told of it, in whom its class wakes nothing.
    pub fn words(&self) -> String {
        match self {
            // What the network library says of it is of no more use.
            Self::Transport { fault: fault @ Fault::Reset, .. } => fault.to_string(),
            Self::Transport { .. } => self.to_string(),
            _ => self.no_data().0,
        }
    }

    /// The reason that stands in place of the value.
    pub fn no_data(&self) -> NoData {
        match self {
            Self::Transport { fault: Fault::Timeout, detail } => NoData::new("timeout", detail),
            Self::Transport { .. } => NoData::new("transport", self.words()),
            Self::Http { .. } | Self::Ascom { .. } if self.is_not_implemented() => NoData::not_implemented(),
            Self::Ascom { code: Self::NOT_CONNECTED, message } => NoData::new("not connected", message),
            Self::Http { status, body } => NoData::new(&format!("http {status}"), body),
            Self::Ascom { code, message } => NoData::new(&format!("ascom 0x{code:X}"), message),
            Self::Protocol(detail) => NoData::new("wrong type", detail),
            Self::Foreign { .. } => NoData::new("wrong type", self),
            Self::NoValue => NoData::new("missing", "the answer has no Value"),
            Self::Value(reason) => reason.clone(),
        }
    }
}
