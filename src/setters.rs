//! Setters of settings.

/// A struct, and a setter for each of its fields, which takes and returns the struct by value. The setter has the
/// field's name and documentation. It takes a number for an `Option` if the type ends in `as into`; a field whose type
/// ends in `as skip` has none.
#[macro_export]
#[doc(hidden)]
macro_rules! setters {
    (
        $(#[$attribute:meta])*
        pub struct $name:ident $(<$life:lifetime>)? {
            $($(#[$doc:meta])* $visibility:vis $field:ident: $type:ty $(as $how:ident)?,)*
        }
    ) => {
        $(#[$attribute])*
        pub struct $name $(<$life>)? {
            $($(#[$doc])* $visibility $field: $type,)*
        }

        impl $(<$life>)? $name $(<$life>)? {
            $($crate::setters!(@ $($how)? [$(#[$doc])*] $field: $type);)*
        }
    };
    (@ skip [$($doc:tt)*] $field:ident: $type:ty) => {};
    (@ into [$($doc:tt)*] $field:ident: $type:ty) => {
        $($doc)*
        #[must_use = "it returns the changed settings"]
        pub fn $field(mut self, value: impl Into<$type>) -> Self {
            self.$field = value.into();
            self
        }
    };
    (@ [$($doc:tt)*] $field:ident: $type:ty) => {
        $($doc)*
        #[must_use = "it returns the changed settings"]
        pub fn $field(mut self, value: $type) -> Self {
            self.$field = value;
            self
        }
    };
}
