//! A pair of left and right values: most things in a differential drive come in pairs, and an index would not say which is which.

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PerWheel<T> {
    pub(crate) left: T,
    pub(crate) right: T,
}

impl<T> PerWheel<T> {
    pub(crate) fn map<U>(self, mut f: impl FnMut(T) -> U) -> PerWheel<U> {
        PerWheel { left: f(self.left), right: f(self.right) }
    }

    pub(crate) fn zip<U>(self, other: PerWheel<U>) -> PerWheel<(T, U)> {
        PerWheel { left: (self.left, other.left), right: (self.right, other.right) }
    }

    pub(crate) const fn as_mut(&mut self) -> PerWheel<&mut T> {
        PerWheel { left: &mut self.left, right: &mut self.right }
    }
}
