"""Pictures of a record and of models."""
