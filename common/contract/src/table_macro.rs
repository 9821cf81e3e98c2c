//! The macro that makes of the table of the bus the topics, the keys and their rows.

macro_rules! bus {
    (
        every kind of device: {
            $(#[doc = $every_meaning:literal] $every:ident $every_word:literal $every_payload:tt $every_row:tt)*
        }
        some kinds of device: {
            $(#[doc = $some_meaning:literal] $some:ident $some_word:literal { $($kind:ident $some_payload:tt)* } $some_row:tt)*
        }
        parts of the observatory node: {
            $(#[doc = $part_meaning:literal] $part:ident $part_word:literal $part_payload:tt $part_row:tt)*
        }
        of a telescope: {
            $(#[doc = $at_meaning:literal] $at:ident [$($at_piece:tt)*] $at_payload:tt $at_row:tt)*
        }
        of a telescope with a name: {
            $(#[doc = $named_meaning:literal] $named:ident [$($named_piece:tt)*] $named_payload:tt $named_row:tt)*
        }
        of a node: {
            $(#[doc = $node_meaning:literal] $node:ident $node_word:literal $node_payload:tt $node_row:tt)*
        }
    ) => {
        words! {
            /// The states that an observatory node publishes.
            Part { $(#[doc = $part_meaning] $part $part_word)* }
        }

        words! {
            /// What a node publishes about itself.
            NodeTopic { $(#[doc = $node_meaning] $node $node_word)* }
        }

        /// A key of the bus; `Display` writes it, [`Key::parse`] reads it.
        #[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Key {
            $(#[doc = $every_meaning] $every(Device),)*
            $(#[doc = $some_meaning] $some(Device),)*
            /// A state of the observatory node.
            Observatory(Address, Part),
            $(#[doc = $at_meaning] $at(Address),)*
            $(#[doc = $named_meaning] $named(Address, Name),)*
            /// A node publishes about itself.
            Node(Address, Role, Name, NodeTopic),
        }

        /// A sort of key: one row of the table.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Topic {
            $(#[doc = $every_meaning] $every,)*
            $(#[doc = $some_meaning] $some,)*
            /// A state of the observatory node.
            Observatory(Part),
            $(#[doc = $at_meaning] $at,)*
            $(#[doc = $named_meaning] $named,)*
            /// A node publishes about itself.
            Node(NodeTopic),
        }

        impl Topic {
            /// All rows, in the order of the table.
            pub const ALL: &[Self] = &[
                $(Self::$every,)*
                $(Self::$some,)*
                $(Self::Observatory(Part::$part),)*
                $(Self::$at,)*
                $(Self::$named,)*
                $(Self::Node(NodeTopic::$node),)*
            ];

            /// What the table declares.
            pub fn row(self) -> TopicRow {
                use Piece::Word;
                match self {
                    $(Self::$every => {
                        fn payloads<K: DeviceKind>() -> Vec<PayloadType> {
                            payloads!($every_payload)
                        }
                        let pieces = &[Word("device"), Piece::Kind(&Kind::ALL), Piece::Name("name"), Word($every_word)];
                        row!(pieces, $every_meaning, |kind| of_kind!(kind, payloads), $every_row)
                    })*
                    $(Self::$some => {
                        fn payloads(kind: Kind) -> Vec<PayloadType> {
                            $(if kind == Kind::$kind {
                                return payloads!($some_payload);
                            })*
                            Vec::new()
                        }
                        const KINDS: &[Kind] = &[$(Kind::$kind),*];
                        let pieces = &[Word("device"), Piece::Kind(KINDS), Piece::Name("name"), Word($some_word)];
                        row!(pieces, $some_meaning, payloads, $some_row)
                    })*
                    $(Self::Observatory(Part::$part) => {
                        let pieces = &[Word("observatory"), Piece::Part($part_word), Word("state")];
                        row!(pieces, $part_meaning, |_| payloads!($part_payload), $part_row)
                    })*
                    $(Self::$at => {
                        let pieces = &[$(piece!($at_piece)),*];
                        row!(pieces, $at_meaning, |_| payloads!($at_payload), $at_row)
                    })*
                    $(Self::$named => {
                        let pieces = &[$(piece!($named_piece)),*];
                        row!(pieces, $named_meaning, |_| payloads!($named_payload), $named_row)
                    })*
                    $(Self::Node(NodeTopic::$node) => {
                        let pieces = &[Word("node"), Piece::Role, Piece::Name("id"), Word($node_word)];
                        row!(pieces, $node_meaning, |_| payloads!($node_payload), $node_row)
                    })*
                }
            }

            /// The key with these values; `None` if one that it needs is absent.
            pub(crate) fn key(
                self,
                address: Address,
                kind: Option<Kind>,
                name: Option<Name>,
                role: Option<Role>,
            ) -> Option<Key> {
                Some(match self {
                    $(Self::$every => Key::$every(Device { address, kind: kind?, name: name? }),)*
                    $(Self::$some => Key::$some(Device { address, kind: kind?, name: name? }),)*
                    Self::Observatory(part) => Key::Observatory(address, part),
                    $(Self::$at => Key::$at(address),)*
                    $(Self::$named => Key::$named(address, name?),)*
                    Self::Node(topic) => Key::Node(address, role?, name?, topic),
                })
            }
        }

        impl Key {
            /// Its row of the table.
            pub fn topic(&self) -> Topic {
                match self {
                    $(Self::$every(_) => Topic::$every,)*
                    $(Self::$some(_) => Topic::$some,)*
                    Self::Observatory(_, part) => Topic::Observatory(*part),
                    $(Self::$at(_) => Topic::$at,)*
                    $(Self::$named(..) => Topic::$named,)*
                    Self::Node(.., topic) => Topic::Node(*topic),
                }
            }

            /// The address that the key is under.
            pub fn address(&self) -> &Address {
                match self {
                    $(Self::$every(device))|* $(| Self::$some(device))* => &device.address,
                    Self::Observatory(address, _) | Self::Node(address, ..) => address,
                    $(Self::$at(address) => address,)*
                    $(Self::$named(address, _) => address,)*
                }
            }

            /// The set that this key alone is in.
            pub(crate) fn alone(&self) -> Keys<'_> {
                let keys = self.topic().everywhere();
                match self {
                    $(Self::$every(device))|* $(| Self::$some(device))* => keys.of_device(device),
                    Self::Observatory(address, _) => keys.at(address),
                    $(Self::$at(address) => keys.at(address),)*
                    $(Self::$named(address, name) => keys.at(address).named(name),)*
                    Self::Node(address, role, id, _) => keys.at(address).of_role(*role).named(id),
                }
            }
        }
    };
}

/// An enumeration of words that stand in keys.
macro_rules! words {
    (#[doc = $doc:literal] $name:ident { $(#[doc = $meaning:literal] $variant:ident $word:literal)* }) => {
        #[doc = $doc]
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum $name {
            $(#[doc = $meaning] $variant,)*
        }

        impl $name {
            /// All of them.
            pub const ALL: [Self; [$($word),*].len()] = [$(Self::$variant),*];
        }
    };
}

macro_rules! row {
    ($pieces:expr, $meaning:literal, $payloads:expr, {
        $rate:expr, $carried:expr, $writer:literal => $reader:literal
    }) => {
        TopicRow {
            pieces: $pieces,
            meaning: $meaning.trim_ascii(),
            rate: $rate,
            carried: $carried,
            writer: $writer,
            reader: $reader,
            payloads: $payloads,
        }
    };
}

macro_rules! payloads {
    ((publishes $payload:ty)) => {
        vec![PayloadType::published::<$payload>()]
    };
    ((asks $question:ty => $answer:ty)) => {
        vec![PayloadType::asked::<$question>(), PayloadType::asked::<$answer>()]
    };
    ((no payload)) => {
        Vec::new()
    };
}

macro_rules! piece {
    ($word:literal) => {
        Piece::Word($word)
    };
    ({ $name:ident }) => {
        Piece::Name(stringify!($name))
    };
}

pub(crate) use {bus, payloads, piece, row, words};
