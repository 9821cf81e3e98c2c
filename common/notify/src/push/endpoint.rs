//! The addresses that messages may be sent to. A person who may only look at telescopes names them, and this server asks them: they must not
//! lead into the network behind it.

use internet::Uri;

const LONGEST: usize = 1000;

/// An address at a push service.
#[derive(Debug, PartialEq, Eq)]
pub struct Endpoint<'a> {
    /// Scheme, host and port.
    pub origin: &'a str,
    /// It is not one that the site's file names.
    pub is_strangers: bool,
}

impl<'a> Endpoint<'a> {
    /// Takes an address of the public internet, or of one of `services`, such as `https://push.example.lan:8443`.
    ///
    /// # Errors
    /// What was expected, and what to do.
    pub fn read(text: &'a str, services: &[String]) -> Result<Self, String> {
        let own = services.iter().filter(|origin| text.strip_prefix(*origin).is_some_and(|rest| rest.starts_with('/')));
        let uri =
            text.parse::<Uri>().ok().filter(|_| text.len() <= LONGEST && text.bytes().all(|b| b.is_ascii_graphic()));
        if let (Some(origin), Some(_)) = (own.map(String::len).max(), &uri) {
            return Ok(Self { origin: &text[..origin], is_strangers: false });
        }
        let is_name = |host: &str| {
            let last = host.rsplit('.').next().unwrap_or_default();
            let letters = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'.';
            // The last part of an address of numbers is a number, in whatever way it is written.
            host.contains('.') && host.bytes().all(letters) && last.starts_with(|c: char| c.is_ascii_alphabetic())
        };
        let is_public = uri.is_some_and(|uri| {
            // No user, and no port.
            let authority = uri.authority().map(|authority| authority.as_str());
            uri.scheme_str() == Some("https") && uri.host() == authority && uri.host().is_some_and(is_name)
        });
        let rest = text.strip_prefix("https://").filter(|_| is_public);
        let host = rest.and_then(|rest| rest.split_once('/')).map(|(host, _)| host);
        match host {
            Some(host) => Ok(Self { origin: &text[..host.len() + "https://".len()], is_strangers: true }),
            None => Err(format!(
                "endpoint: expected the address that a browser has from its push service, such as \
                 https://updates.push.services.mozilla.com/wpush/v2/..., at most {LONGEST} characters: https, a name, and no \
                 port; a push service of the site's own network is named in web.push_services"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_public_internet_and_services_of_the_file_are_sent_to() {
        let services = ["http://127.0.0.1:9000".to_owned(), "https://push.lan".to_owned()];
        let read = |text| Endpoint::read(text, &services).ok().map(|found| (found.origin, found.is_strangers));
        for (text, wanted) in [
            ("https://fcm.googleapis.com/fcm/send/a:b", Some(("https://fcm.googleapis.com", true))),
            ("https://web.push.apple.com/QG", Some(("https://web.push.apple.com", true))),
            ("http://127.0.0.1:9000/x", Some(("http://127.0.0.1:9000", false))),
            ("https://push.lan/x", Some(("https://push.lan", false))),
            ("https://push.lan.evil.example/x", Some(("https://push.lan.evil.example", true))),
            ("http://127.0.0.1:90001/x", None),
            ("http://127.0.0.1:9000@evil.example/x", None),
            ("http://fcm.googleapis.com/x", None),
            ("https://fcm.googleapis.com:8443/x", None),
            ("https://fcm.googleapis.com", None),
            ("https://user@fcm.googleapis.com/x", None),
            ("https://localhost/x", None),
            ("https://router/x", None),
            ("https://192.168.1.1/x", None),
            ("https://[::1]/x", None),
            ("https://0x7f.0.0.0x1/x", None),
            ("https://127.1/x", None),
            ("https://a.example/x y", None),
            ("ftp://a.example/x", None),
            ("", None),
        ] {
            assert_eq!(read(text), wanted, "{text}");
        }
        assert_eq!(read(&format!("https://a.example/{}", "x".repeat(1000))), None);
    }
}
