"""A whole mount made of any family's language, a whole camera made of any protocol's."""
