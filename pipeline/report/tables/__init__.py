"""What stage report writes: tables for people, flat figures and curves for DVC."""
