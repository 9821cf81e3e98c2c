//! The magnitudes that a catalogue may have.

/// A magnitude of Gaia or 2MASS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Band {
    /// Gaia G.
    G,
    /// Gaia BP.
    Bp,
    /// Gaia RP.
    Rp,
    /// 2MASS J.
    J,
    /// 2MASS H.
    H,
    /// 2MASS Ks.
    Ks,
}

impl Band {
    /// All of them, in the order in which one stands in for another that a star does not have.
    pub const ALL: [Self; 6] = [Self::G, Self::J, Self::Rp, Self::Bp, Self::H, Self::Ks];

    /// The band of a word such as `G`, `BP` or `Ks`, whatever its case.
    pub fn named(word: &str) -> Option<Self> {
        Some(match word.trim().to_ascii_lowercase().as_str() {
            "g" => Self::G,
            "bp" => Self::Bp,
            "rp" => Self::Rp,
            "j" => Self::J,
            "h" => Self::H,
            "k" | "ks" => Self::Ks,
            _ => return None,
        })
    }

    /// The names of columns of this magnitude: by the Gaia archive, the Gaia-2MASS files, VizieR and 2MASS.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            Self::G => &["phot_g_mean_mag", "gmag", "g_mag"],
            Self::Bp => &["phot_bp_mean_mag", "bpmag", "bp_mag"],
            Self::Rp => &["phot_rp_mean_mag", "rpmag", "rp_mag"],
            Self::J => &["j_m", "jmag", "j_mag"],
            Self::H => &["h_m", "hmag", "h_mag"],
            Self::Ks => &["ks_m", "k_m", "kmag", "ksmag", "ks_mag"],
        }
    }
}
