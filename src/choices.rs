//! Enums whose values people choose by name: on the command line, in Python, in files.

/// A value that people choose by its name.
pub trait Choice: Copy + 'static {
    /// All that can be chosen.
    const CHOICES: &'static [Self];

    /// Its name, the same wherever people write or read it.
    fn name(self) -> &'static str;

    /// What it means, in a line.
    fn help(self) -> &'static str;

    /// The value of a name.
    #[must_use]
    fn named(name: &str) -> Option<Self> {
        Self::CHOICES.iter().copied().find(|choice| choice.name() == name)
    }
}

/// An enum that is a [`Choice`]. Behind each of its values stand its name and what it means, which begins its
/// documentation.
#[macro_export]
#[doc(hidden)]
macro_rules! choices {
    (
        $(#[$attribute:meta])*
        pub enum $name:ident {
            $($(#[$more:meta])* $value:ident = $text:literal, $help:literal;)*
        }
    ) => {
        $(#[$attribute])*
        pub enum $name {
            $(
                #[doc = $help]
                #[doc = ""]
                $(#[$more])*
                #[serde(rename = $text)]
                $value,
            )*
        }

        impl $name {
            /// All values.
            pub const ALL: [Self; [$($text),*].len()] = [$(Self::$value),*];

            /// Its name on the command line, in Python and in files.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$value => $text,)*
                }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }

        impl $crate::choices::Choice for $name {
            const CHOICES: &'static [Self] = &Self::ALL;

            fn name(self) -> &'static str {
                self.name()
            }

            fn help(self) -> &'static str {
                match self {
                    $(Self::$value => $help,)*
                }
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use serde::de::DeserializeOwned;

    use super::Choice;
    use crate::posterior::{Covariance, Criterion};

    /// Files and Python read names by serde.
    #[test]
    fn names_are_those_of_files() {
        fn check<T: Choice + DeserializeOwned + PartialEq + Debug>() {
            for &choice in T::CHOICES {
                assert_eq!(serde_json::from_value::<T>(choice.name().into()).unwrap(), choice);
                assert_eq!(T::named(choice.name()), Some(choice));
            }
            assert_eq!(T::named("uniform"), None);
        }
        check::<Covariance>();
        check::<Criterion>();
    }
}
