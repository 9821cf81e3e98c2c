//! Which frames of a night a destination gets.

use config::header::Source;
use config::{Delivery, Observatory};
use contract::CommandId;

use crate::database::StoredImage;
use crate::night::{Night, NightFrame};
use crate::reader::Reader;

/// What a destination gets of a night.
#[derive(Debug, Default)]
pub struct Selected {
    /// The frames, in the order of their exposures.
    pub images: Vec<StoredImage>,
    /// How many of them have no complete header yet.
    pub incomplete: usize,
}

impl Selected {
    /// Looks into the database. Blocks.
    pub fn of(reader: &Reader, night: &Night, config: &Observatory, delivery: &Delivery) -> anyhow::Result<Self> {
        let (frames, wanted) = (reader.frames(night.from, night.to)?, Wanted::new(config, delivery)?);
        let mut selected = Self::default();
        for NightFrame { image, is_complete, .. } in frames.into_iter().filter(|frame| wanted.takes(frame)) {
            selected.incomplete += usize::from(!is_complete);
            selected.images.push(image);
        }
        Ok(selected)
    }

    /// The ids of the frames.
    pub fn ids(&self) -> impl Iterator<Item = &CommandId> {
        self.images.iter().map(|image| &image.frame.id)
    }
}

/// What a destination asks for.
#[derive(Debug)]
pub struct Wanted<'a> {
    delivery: &'a Delivery,
    /// The programme that the site's FITS-header table gives to frames whose row names none.
    usual_programme: String,
}

impl<'a> Wanted<'a> {
    /// What a section of the configuration asks for. Blocks.
    ///
    /// # Errors
    /// It asks for programmes, and the FITS-header table cannot be read.
    pub fn new(config: &Observatory, delivery: &'a Delivery) -> anyhow::Result<Self> {
        let mut usual_programme = String::new();
        if !delivery.programmes.is_empty() {
            let table = node::configuration::read_header(config)?;
            let row = table.rows.into_iter().find(|row| row.keyword == "PROGID");
            if let Some(Source::Static(programme)) = row.map(|row| row.source) {
                usual_programme = programme;
            }
        }
        Ok(Self { delivery, usual_programme })
    }

    /// Does the destination get this frame?
    pub fn takes(&self, frame: &NightFrame) -> bool {
        let (delivery, purpose) = (self.delivery, &frame.image.frame.purpose);
        let kind = purpose.image_type.to_ascii_lowercase();
        let has_kind = delivery.image_types.iter().any(|wanted| kind.split(' ').next() == Some(wanted.as_str()));
        let has_action = delivery.actions.contains(&purpose.action);
        let has_camera = delivery.cameras.iter().any(|wanted| wanted.as_str() == frame.image.frame.camera);
        let has_programme = delivery.programmes.contains(purpose.programme.as_ref().unwrap_or(&self.usual_programme));
        (delivery.image_types.is_empty() || has_kind)
            && (delivery.actions.is_empty() || has_action)
            && (delivery.cameras.is_empty() || has_camera)
            && (delivery.programmes.is_empty() || has_programme)
    }
}
