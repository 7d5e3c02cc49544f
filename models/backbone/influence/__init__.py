"""What dropping a term of a backbone's equations does, bounded beforehand."""
