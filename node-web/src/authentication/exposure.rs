//! Where the page may be served: beyond this host only with users.

use config::Web;

/// May the page be served there? `starmesh check` and the web node ask this one function.
///
/// # Errors
/// Why not, and what to do.
pub fn may_listen(web: &Web) -> Result<(), String> {
    if !web.needs_users() {
        return Ok(());
    }
    let (listen, file) = (web.listen, web.users.display());
    let why = match users::read(&web.users) {
        Ok(Some(users)) if !users.users.is_empty() => return Ok(()),
        Ok(Some(_)) => format!("{file} has no user"),
        Ok(None) => format!("there is no {file}"),
        Err(why) => why.to_string(),
    };
    let (key, others) = if web.listen.ip().is_loopback() {
        ("web.trust_proxy".to_owned(), "those whom the proxy lets through")
    } else {
        (format!("web.listen = \"{listen}\""), "others than the people on this host")
    };
    Err(format!(
        "{key}: {others} could reach the page, and {why}: make a user with `starmesh user add NAME --right operator`, or set \
         web.insecure_open = true where everybody who reaches this address may open the dome"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_beyond_this_host_needs_a_user_or_a_word_that_nobody_is_asked() {
        let folder = tempfile::tempdir().unwrap();
        let web =
            Web { listen: "0.0.0.0:8080".parse().unwrap(), users: folder.path().join("users.toml"), ..Web::default() };
        let local = Web { listen: Web::default().listen, ..web.clone() };
        let proxied = Web { trust_proxy: vec!["127.0.0.1".parse().unwrap()], ..local.clone() };
        assert!(may_listen(&local).is_ok() && may_listen(&Web { insecure_open: true, ..web.clone() }).is_ok());
        for (web, key) in [(&web, "web.listen = \"0.0.0.0:8080\""), (&proxied, "web.trust_proxy")] {
            let why = may_listen(web).unwrap_err();
            assert!(why.starts_with(key) && why.contains("there is no") && why.contains("starmesh user add"), "{why}");
        }
        let write = |change: fn(&mut users::Users)| {
            users::edit(&web.users, |users| {
                change(users);
                Ok::<_, users::FileFault>(())
            })
            .unwrap();
        };
        write(|_| ());
        assert!(may_listen(&web).unwrap_err().contains("has no user"));
        write(|users| {
            let password = users::PasswordHash::of_new("four plain words here", "ana").unwrap();
            users
                .users
                .insert("ana".parse().unwrap(), users::User { password, grants: vec!["viewer".parse().unwrap()] });
        });
        assert!(may_listen(&web).is_ok() && may_listen(&proxied).is_ok());
    }
}
