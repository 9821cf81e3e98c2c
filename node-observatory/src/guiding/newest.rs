//! The frame to guide on next.

use std::sync::Arc;

use tokio::sync::broadcast;

use crate::frames::looked::Fetched;

/// The newest frame of a camera; those that waited meanwhile are passed over.
pub async fn newest(pixels: &mut broadcast::Receiver<Arc<Fetched>>, camera: &str) -> Arc<Fetched> {
    let mut found: Option<Arc<Fetched>> = None;
    loop {
        match pixels.try_recv() {
            Ok(fetched) if fetched.frame.camera == camera => found = Some(fetched),
            Ok(_) | Err(broadcast::error::TryRecvError::Lagged(_)) => {}
            Err(_) => match found {
                Some(found) => return found,
                None => match pixels.recv().await {
                    Ok(fetched) if fetched.frame.camera == camera => found = Some(fetched),
                    Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => {}
                    // The sender lives as long as the node.
                    Err(broadcast::error::RecvError::Closed) => std::future::pending().await,
                },
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::frames::looked::Looks;
    use crate::frames::measure::Plane;
    use crate::frames::tests::frame;

    #[tokio::test]
    async fn of_frames_that_waited_the_newest_of_the_camera_counts() {
        let looks = Looks::default();
        let mut pixels = looks.follow_pixels();
        let fetched = |id: &str, camera: &str| {
            let frame = contract::device::camera::Frame { camera: camera.to_owned(), ..frame(id) };
            looks.fetched(&Arc::new(Fetched {
                frame,
                plane: Plane::Counts(Vec::new()),
                camera: imaging::Camera::default(),
            }));
        };
        // More than wait: the oldest is gone.
        for (id, camera) in [("a", "cam"), ("b", "cam"), ("c", "cam")] {
            fetched(id, camera);
        }
        assert_eq!(newest(&mut pixels, "cam").await.frame.id.0, "c");
        fetched("d", "cam");
        fetched("e", "other");
        assert_eq!(newest(&mut pixels, "cam").await.frame.id.0, "d");
        fetched("f", "other");
        let none = tokio::time::timeout(Duration::from_millis(20), newest(&mut pixels, "cam")).await;
        assert!(none.is_err(), "frames of other cameras are nothing to guide on");
    }
}
