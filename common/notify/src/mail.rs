//! E-mail.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, anyhow, bail};
use config::{Security, Smtp};
use internet::trust;
use lettre::address::Envelope;
use lettre::message::header::ContentType;
use lettre::message::{Mailbox, MessageBuilder};
use lettre::transport::smtp::authentication::{Credentials, Mechanism};
use lettre::transport::smtp::client::{AsyncSmtpConnection, Certificate, TlsParameters};
use lettre::transport::smtp::extension::ClientId;

use crate::safe;
use crate::secret::secret;

/// Connecting and greeting, machine time.
const STEP: Duration = Duration::from_secs(15);
/// The whole exchange.
const WHOLE: Duration = Duration::from_secs(60);

/// One mail to one address. Each of a receiver's addresses gets a mail of its own: an address that the server refuses
/// must not stop the others.
pub struct Mail<'a> {
    /// The address.
    pub to: &'a str,
    /// All addresses; shown in its head.
    pub all: &'a [String],
    /// The subject, one line.
    pub subject: &'a str,
    /// The text, many lines.
    pub text: String,
}

/// Sends one mail.
///
/// # Errors
///
/// The server is not reached, is not the one that its certificate names, does not encrypt the connection as configured,
/// or refuses login, address or mail. Nothing was sent in the open then.
pub async fn send(smtp: &Smtp, ca_file: Option<&Path>, mail: Mail<'_>) -> anyhow::Result<()> {
    let from: Mailbox =
        smtp.from.parse().with_context(|| format!("alerts.smtp.from: \"{}\" is no address", smtp.from))?;
    let to = mailbox(mail.to)?;
    let envelope = Envelope::new(Some(from.email.clone()), vec![to.email]).context("the mail cannot be addressed")?;
    let message = MessageBuilder::new().from(from).subject(mail.subject).header(ContentType::TEXT_PLAIN);
    let message = mail.all.iter().try_fold(message, |message, to| anyhow::Ok(message.to(mailbox(to)?)))?;
    let message = message.body(mail.text).context("the mail cannot be written")?.formatted();

    let hand_over = async {
        let login = login(smtp).await?;
        let mut server = connect(smtp, ca_file).await?;
        if let Some(login) = &login {
            log_in(&mut server, login).await?;
        }
        let sent = server.send(&envelope, &message).await;
        sent.map_err(|error| describe("the mail server does not take it", &error, login.as_ref()))?;
        // The mail is taken: the end of the connection changes nothing, and a failure in it must not send the mail
        // twice.
        let _ = tokio::time::timeout(Duration::from_secs(1), server.abort()).await;
        Ok(())
    };
    tokio::time::timeout(WHOLE, hand_over).await.context("the mail server did not finish within 60 s")?
}

fn mailbox(to: &str) -> anyhow::Result<Mailbox> {
    to.parse().with_context(|| format!("to: \"{to}\" is no address"))
}

async fn connect(smtp: &Smtp, ca_file: Option<&Path>) -> anyhow::Result<AsyncSmtpConnection> {
    let port = smtp.port.unwrap_or(match smtp.security {
        Security::Starttls => 587,
        Security::Tls => 465,
        Security::None => 25,
    });
    let tls = match smtp.security {
        Security::None => None,
        Security::Starttls | Security::Tls => Some(tls(smtp.server.clone(), ca_file.map(Path::to_owned)).await?),
    };
    let (from_start, later) = if smtp.security == Security::Tls { (tls, None) } else { (None, tls) };
    let (name, address) = (ClientId::default(), (smtp.server.as_str(), port));
    let connected = AsyncSmtpConnection::connect_tokio1(address, Some(STEP), &name, from_start, None);
    let connected =
        tokio::time::timeout(STEP, connected).await.context("the mail server does not greet within 15 s")?;
    let mut server = connected.map_err(|error| describe("the mail server cannot be reached", &error, None))?;
    if let Some(tls) = later {
        if !server.can_starttls() {
            server.abort().await;
            bail!(
                "the mail server offers no STARTTLS, and nothing goes there in the open: look at alerts.smtp.port, or \
                 set security = \"tls\" where it wants TLS from the first byte"
            );
        }
        let encrypted = server.starttls(tls, &name).await;
        encrypted.map_err(|error| describe("the mail server cannot be reached by TLS", &error, None))?;
    }
    Ok(server)
}

/// TLS to this server, with the host's authorities and the site's own.
async fn tls(server: String, ca_file: Option<PathBuf>) -> anyhow::Result<TlsParameters> {
    let prepare = move || {
        let mut tls = TlsParameters::builder(server);
        for own in ca_file.as_deref().map(trust::own).transpose()?.into_iter().flatten() {
            let own = Certificate::from_der(own.to_vec()).context("alerts.ca_file: a certificate in it is not one")?;
            tls = tls.add_root_certificate(own);
        }
        tls.build().context("TLS cannot be prepared on this host")
    };
    tokio::task::spawn_blocking(prepare).await.context("reading certificates was cut short")?
}

/// The user name and the password of a login.
struct Login {
    user: String,
    password: String,
}

async fn login(smtp: &Smtp) -> anyhow::Result<Option<Login>> {
    let Some(user) = smtp.user.clone() else { return Ok(None) };
    let password = secret(smtp.password_file.as_deref(), smtp.password_env.as_deref()).await?.unwrap_or_default();
    Ok(Some(Login { user, password }))
}

async fn log_in(server: &mut AsyncSmtpConnection, login: &Login) -> anyhow::Result<()> {
    let ways = [Mechanism::Plain, Mechanism::Login];
    if server.server_info().get_auth_mechanism(&ways).is_none() {
        server.abort().await;
        bail!("the mail server offers no login by PLAIN or LOGIN here: look at alerts.smtp.security and .port");
    }
    let logged_in = server.auth(&ways, &Credentials::new(login.user.clone(), login.password.clone())).await;
    logged_in.map_err(|error| {
        describe("the mail server refuses the login: look at alerts.smtp.user and its password", &error, Some(login))
    })?;
    Ok(())
}

/// The server's own words, once; or the reason why TLS refused. After a login only the parts that cannot contain it are
/// reported: a server may repeat what it was sent, as it came or in a code of its own.
fn describe(what: &str, error: &lettre::transport::smtp::Error, login: Option<&Login>) -> anyhow::Error {
    if let Some(why) = trust::explain(error) {
        return anyhow!("the mail server: {why}");
    }
    // The error already contains its source.
    let words = error.to_string();
    match login {
        None => anyhow!("{what}: {}", safe::line(&words)),
        Some(login) => anyhow!("{what}: {}", safe::without(&words, &[&login.password])),
    }
}
