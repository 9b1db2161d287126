//! Which `const` functions constants need; the others lose `const`, because the switch is read at run time.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens;
use syn::visit::{self, Visit};

/// Names that are mentioned where the compiler evaluates, and the bodies of constant functions by name.
#[derive(Default)]
pub(crate) struct NeededConst {
    pub(crate) needed: BTreeSet<String>,
    pub(crate) bodies: BTreeMap<String, BTreeSet<String>>,
}

impl NeededConst {
    pub(crate) fn closure(mut self) -> BTreeSet<String> {
        let mut waiting: Vec<String> = self.needed.iter().cloned().collect();
        while let Some(name) = waiting.pop() {
            for called in self.bodies.get(&name).cloned().unwrap_or_default() {
                if self.needed.insert(called.clone()) {
                    waiting.push(called);
                }
            }
        }
        self.needed
    }
    pub(crate) fn add(&mut self, tokens: TokenStream) {
        identifiers(tokens, &mut self.needed);
    }
    pub(crate) fn body(&mut self, signature: &syn::Signature, block: &syn::Block) {
        if signature.constness.is_some() {
            identifiers(block.to_token_stream(), self.bodies.entry(signature.ident.to_string()).or_default());
        }
    }
}

pub(crate) fn identifiers(tokens: TokenStream, into: &mut BTreeSet<String>) {
    for token in tokens {
        match token {
            TokenTree::Ident(name) => drop(into.insert(name.to_string())),
            TokenTree::Group(group) => identifiers(group.stream(), into),
            _ => {}
        }
    }
}

impl<'a> Visit<'a> for NeededConst {
    fn visit_item_const(&mut self, i: &'a syn::ItemConst) {
        self.add(i.expr.to_token_stream());
        visit::visit_item_const(self, i);
    }
    fn visit_item_static(&mut self, i: &'a syn::ItemStatic) {
        self.add(i.expr.to_token_stream());
        visit::visit_item_static(self, i);
    }
    fn visit_impl_item_const(&mut self, i: &'a syn::ImplItemConst) {
        self.add(i.expr.to_token_stream());
        visit::visit_impl_item_const(self, i);
    }
    fn visit_trait_item_const(&mut self, i: &'a syn::TraitItemConst) {
        if let Some((_, expr)) = &i.default {
            self.add(expr.to_token_stream());
        }
        visit::visit_trait_item_const(self, i);
    }
    fn visit_type_array(&mut self, i: &'a syn::TypeArray) {
        self.add(i.len.to_token_stream());
        visit::visit_type_array(self, i);
    }
    fn visit_expr_repeat(&mut self, i: &'a syn::ExprRepeat) {
        // A constant function's value may be repeated without Copy.
        self.add(i.len.to_token_stream());
        visit::visit_expr_repeat(self, i);
    }
    fn visit_expr_const(&mut self, i: &'a syn::ExprConst) {
        self.add(i.block.to_token_stream());
        visit::visit_expr_const(self, i);
    }
    fn visit_variant(&mut self, i: &'a syn::Variant) {
        if let Some((_, expr)) = &i.discriminant {
            self.add(expr.to_token_stream());
        }
        visit::visit_variant(self, i);
    }
    fn visit_generic_argument(&mut self, i: &'a syn::GenericArgument) {
        if let syn::GenericArgument::Const(expr) = i {
            self.add(expr.to_token_stream());
        }
        visit::visit_generic_argument(self, i);
    }
    fn visit_macro(&mut self, i: &'a syn::Macro) {
        let name = i.path.segments.last().map(|s| s.ident.to_string()).unwrap_or_default();
        let text = i.tokens.to_string();
        if name == "thread_local" || name == "macro_rules" || text.contains("const ") || text.contains("static ") {
            self.add(i.tokens.clone());
        }
    }
    fn visit_item_macro(&mut self, i: &'a syn::ItemMacro) {
        self.add(i.mac.tokens.clone());
    }
    fn visit_item_fn(&mut self, i: &'a syn::ItemFn) {
        self.body(&i.sig, &i.block);
        visit::visit_item_fn(self, i);
    }
    fn visit_impl_item_fn(&mut self, i: &'a syn::ImplItemFn) {
        self.body(&i.sig, &i.block);
        visit::visit_impl_item_fn(self, i);
    }
}

pub(crate) struct StripConst<'n> {
    pub(crate) needed: &'n BTreeSet<String>,
    pub(crate) ranges: Vec<Range<usize>>,
}

impl StripConst<'_> {
    pub(crate) fn signature(&mut self, signature: &syn::Signature) {
        if let Some(word) = &signature.constness
            && !self.needed.contains(&signature.ident.to_string())
        {
            self.ranges.push(word.span.byte_range());
        }
    }
}

impl<'a> Visit<'a> for StripConst<'_> {
    fn visit_item_fn(&mut self, i: &'a syn::ItemFn) {
        self.signature(&i.sig);
        visit::visit_item_fn(self, i);
    }
    fn visit_impl_item_fn(&mut self, i: &'a syn::ImplItemFn) {
        self.signature(&i.sig);
        visit::visit_impl_item_fn(self, i);
    }
}
