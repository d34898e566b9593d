//! Turns the library's names of settings into the flags that users type.

use octobayes::Error;

/// The library's name of a setting, and the flag that sets it.
const FLAGS: [(&str, &str); 26] = [
    ("angle of view", "--fov"),
    ("audit", "--audit"),
    ("candidates", "--candidates"),
    ("criteria", "--refine"),
    ("criterion `density`", "--refine density"),
    ("cutoff", "--cutoff"),
    ("dense grid", "--grid dense"),
    ("depth", "--depth"),
    ("depth encoding", "--depth-encoding"),
    ("error bars", "--error-bars"),
    ("gradient", "--gradient"),
    ("groups of rays", "--error-bars"),
    ("kept sums", "--keep-sums"),
    ("lambda", "--lambda"),
    ("map", "--map"),
    ("memory budget", "--memory"),
    ("occupancy", "--occupancy"),
    ("points", "--points"),
    ("pooling", "--pooling"),
    ("probability", "--probability"),
    ("ray average", "--ray-average"),
    ("resolution", "--resolution"),
    ("run to a mean error", "--target-error"),
    ("scale", "--scale data"),
    ("shard", "--shard"),
    ("training views", "--views"),
];

/// The error as the command line words it: with the flag in place of the setting's name.
#[must_use]
pub fn in_flags(error: Error) -> Error {
    match error {
        Error::Setting { what, expected, found } => {
            let flag = FLAGS.iter().find(|(setting, _)| *setting == what).map(|(_, flag)| (*flag).to_string());
            Error::Setting { what: flag.unwrap_or(what), expected, found }
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_named_by_their_flags_and_others_stay() {
        let said = |what: &str| in_flags(Error::setting(what, "a", "b")).to_string();
        assert_eq!(said("memory budget"), "--memory: expected a, found b");
        assert_eq!(said("fields to merge"), "fields to merge: expected a, found b");
        assert!(FLAGS.windows(2).all(|pair| pair[0].0 < pair[1].0), "sorted, so that none stands twice");
    }
}
