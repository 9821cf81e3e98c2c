//! E-mail.

use std::time::Duration;

use anyhow::Context as _;
use config::{Email, Security, Smtp};
use lettre::message::header::ContentType;
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Tls, TlsParameters};
use lettre::{AsyncSmtpTransport, AsyncTransport as _, Message, Tokio1Executor};

use crate::post::secret;

/// Each step of the exchange, machine time.
const STEP: Duration = Duration::from_secs(15);
/// The whole of it.
const WHOLE: Duration = Duration::from_secs(60);

/// Sends one mail to all addresses of a receiver; an answer of the server that refuses it is an error.
pub async fn send(smtp: &Smtp, email: &Email, subject: &str, text: String) -> anyhow::Result<()> {
    let from = smtp.from.parse().with_context(|| format!("alerts.smtp.from: \"{}\" is no address", smtp.from))?;
    let mut message = Message::builder().from(from).subject(subject).header(ContentType::TEXT_PLAIN);
    for to in &email.to {
        message = message.to(to.parse().with_context(|| format!("to: \"{to}\" is no address"))?);
    }
    let message = message.body(text).context("the mail cannot be written")?;
    let tls = || TlsParameters::new(smtp.server.clone()).context("TLS cannot be prepared on this host");
    let (tls, port) = match smtp.security {
        Security::Starttls => (Tls::Required(tls()?), 587),
        Security::Tls => (Tls::Wrapper(tls()?), 465),
        Security::None => (Tls::None, 25),
    };
    let mut transport = AsyncSmtpTransport::<Tokio1Executor>::builder_dangerous(&smtp.server)
        .port(smtp.port.unwrap_or(port))
        .tls(tls)
        .timeout(Some(STEP));
    if let Some(user) = &smtp.user {
        let password = secret(smtp.password_file.as_deref(), smtp.password_env.as_deref()).await?.unwrap_or_default();
        transport = transport.credentials(Credentials::new(user.clone(), password));
    }
    let sending = transport.build();
    let sent = tokio::time::timeout(WHOLE, sending.send(message)).await;
    sent.context("the mail server did not finish within 60 s")?.context("the mail server does not take it")?;
    Ok(())
}
