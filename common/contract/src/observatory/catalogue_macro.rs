//! The macro that makes of the catalogue's rows the enumeration of alerts and their table.

macro_rules! catalogue {
    ($($(#[doc = $means:literal])+ $kind:ident: $entry:expr,)*) => {
        /// A sort of alert. The text of each is its explanation in `docs/operator/alerts.md`.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum AlertKind {
            $($(#[doc = $means])+ $kind,)*
        }

        impl AlertKind {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$kind),*];

            /// Its row of the catalogue.
            pub const fn entry(self) -> &'static AlertEntry {
                match self {
                    $(Self::$kind => {
                        const ENTRY: AlertEntry = $entry;
                        &ENTRY
                    })*
                }
            }

            /// What has happened, for a person.
            pub const fn means(self) -> &'static str {
                match self {
                    $(Self::$kind => const { concat!($($means),+).trim_ascii() },)*
                }
            }
        }
    };
}

pub(super) use catalogue;
